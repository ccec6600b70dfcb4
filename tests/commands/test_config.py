"""`calm-edge config` prints a file that gives the same configuration; every key is described."""

from __future__ import annotations

import json
import os
import runpy
import tomllib
from pathlib import Path

import pytest

from calm_edge.cli import main
from calm_edge.commands.config_text import commented, sections, toml
from calm_edge.config import Config, ConfigError, load, merge
from calm_edge.recording.writer import RecordingWriter

CHANGED = {
    "capture": {"primary": 'v4l2:odd "name" \x07 \x7f €', "exposure_us": 8000, "gain": "auto"},
    "scale": {"spacing_m": 0.52},
    "backbone": {"hfov_deg": [80.0, 79.5], "max_views": 4},
    "loops": {"enabled": False},
    "calibration": {
        "file": ["a.yaml"],
        "cameras": [
            {
                "model": "fisheye",
                "fx": 1e-7,
                "fy": 2.0,
                "cx": 3.0,
                "cy": 4.0,
                "width": 5,
                "height": 6,
            }
        ],
    },
}


def printed(capsys: pytest.CaptureFixture[str], *options: str) -> str:
    assert main(["config", *options]) == 0
    return capsys.readouterr().out


@pytest.mark.parametrize("options", [(), ("--changed",)])
def test_what_is_printed_reads_back_to_the_same(
    options: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wanted = merge(Config(), CHANGED)
    first, again = tmp_path / "first.toml", tmp_path / "again.toml"
    first.write_text(commented(wanted), "utf-8")
    again.write_text(printed(capsys, "--config", str(first), *options), "utf-8")
    assert load(again) == wanted


def test_all_keys_are_printed_and_a_changed_one_has_its_default(
    capsys: pytest.CaptureFixture[str],
) -> None:
    text = printed(capsys, "--spacing-m", "0.52")
    assert tomllib.loads(text) == json.loads(printed(capsys, "--spacing-m", "0.52", "--json"))
    assert "spacing_m = 0.52  # default: 0.0\n" in text and text.count("# default:") == 1
    lines = printed(capsys, "--spacing-m", "0.52", "--changed").splitlines()
    assert [line for line in lines if not line.startswith("#")] == [
        "[scale]",
        "spacing_m = 0.52  # default: 0.0",
    ]
    assert printed(capsys, "--changed") == ""


def test_a_recording_gives_the_configuration_it_was_made_with(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    made = merge(Config(), CHANGED)
    RecordingWriter(tmp_path / "rec", made).close()
    (tmp_path / "kit.toml").write_text(printed(capsys, str(tmp_path / "rec")), "utf-8")
    assert load(tmp_path / "kit.toml") == made


@pytest.mark.parametrize(
    ("assignment", "words"),
    [
        ("capture.primary=v4l3:usb-1", "unknown driver 'v4l3'"),
        ("capture.focus=sharp", "capture.focus = 'sharp'"),
        ("recording.segment_s=0", "recording.segment_s = 0"),
        ("degrade.cool_c=99", "degrade.cool_c = 99"),
        ("backbone.name=bundle:no-such", "no-such"),
        ("backbone.precision=fp16", "backbone.precision = fp16"),
        ("pose_output.rate_hz=0", "pose_output.rate_hz = 0"),
        ("scale.spacing_m=52", "52 cm are 0.52"),
    ],
)
def test_what_record_would_refuse_is_refused(
    assignment: str, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["config", "--set", assignment]) == 1
    captured = capsys.readouterr()
    assert words in captured.err and captured.err.count("\n") == 1 and not captured.out


def test_a_name_that_is_not_unicode_is_refused() -> None:
    with pytest.raises(ConfigError, match="not UTF-8"):
        toml(os.fsdecode(b"m\xe9sk.png"))


def test_every_section_and_key_is_described() -> None:
    missing = [s.name for s in sections() if not s.text]
    missing += [f"{s.name}.{key.name}" for s in sections() for key in s.keys if not key.text]
    assert not missing, "add lines `key: what it does.` to the docstring in calm_edge/config.py"


def test_the_reference_in_the_docs_has_the_same_text() -> None:
    docs = Path(__file__).parents[2] / "docs"
    page = runpy.run_path(str(docs / "configuration.py"))["page"]()
    assert page == (docs / "configuration.md").read_text("utf-8"), "run docs/configuration.py"
