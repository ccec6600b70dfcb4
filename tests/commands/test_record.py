"""Configuration of a replay: that of the recording, which options override."""

from __future__ import annotations

from pathlib import Path

import pytest

from calm_edge.cli import build_parser, main
from calm_edge.commands.configuration import effective_config
from calm_edge.commands.record import recorded_config
from calm_edge.config import Config, ConfigError, merge
from calm_edge.recording.reader import Recording
from calm_edge.recording.writer import RecordingWriter
from calm_edge.types import CalmEdgeError

RECORDED = {
    "scale": {"spacing_m": 0.52},
    "backbone": {"name": "bundle", "kit_file": "kits/car.json"},
    "frontend": {"n_max": 8},
    "pose_output": {"port": "/dev/ttyUSB0", "rate_hz": 10.0},
    "capture": {"primary": "v4l2:usb-1"},
    "live": {"socket": "/run/calm-edge/live.sock"},
}


@pytest.fixture
def recording(tmp_path: Path) -> Recording:
    RecordingWriter(tmp_path / "rec", merge(Config(), RECORDED)).close()
    return Recording(tmp_path / "rec")


def of_replay(recording: Recording, *options: str) -> Config:
    arguments = ["record", "--replay", str(recording.path), "--out", "again", *options]
    return effective_config(build_parser().parse_args(arguments), recorded_config(recording))


def test_a_replay_takes_all_but_the_kit_file_and_the_port(
    recording: Recording, capsys: pytest.CaptureFixture[str]
) -> None:
    config = of_replay(recording)
    (line,) = capsys.readouterr().err.splitlines()
    assert "configuration of" in line and "bundle, cameras 0.52 m apart" in line
    assert config.scale.spacing_m == 0.52 and config.frontend.n_max == 8
    assert config.capture.primary == "v4l2:usb-1"
    assert config.backbone.kit_file == config.pose_output.port == config.live.socket == ""


@pytest.mark.parametrize(
    "options, socket",
    [
        ([], ""),
        (["--live"], "{run}/calm-edge/live.sock"),
        (["--live", "--set", "live.socket=/tmp/mine.sock"], "/tmp/mine.sock"),
    ],
)
def test_results_are_offered_to_the_live_page_only_on_request(
    options: list[str],
    socket: str,
    recording: Recording,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    given: list[Config] = []

    def record(config: Config, *_: object, **__: object) -> None:
        given.append(config)
        raise CalmEdgeError("no more is wanted here")

    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setattr("calm_edge.daemon.run.record", record)
    monkeypatch.setattr("calm_edge.daemon.source.of_recording", lambda *_: None)
    out = str(tmp_path / "again")
    assert main(["record", "--replay", str(recording.path), "--out", out, *options]) == 1
    assert [config.live.socket for config in given] == [socket.format(run=tmp_path)]


def test_options_and_files_override_it(recording: Recording, tmp_path: Path) -> None:
    file = tmp_path / "kit.toml"
    file.write_text("[frontend]\nn_max = 9\n[scale]\nspacing_m = 0.6\n")
    options = ("--config", str(file), "--spacing-m", "0.7", "--set", "backbone.kit_file=mine.json")
    config = of_replay(recording, *options)
    assert config.scale.spacing_m == 0.7 and config.frontend.n_max == 9
    assert config.backbone.kit_file == "mine.json" and config.backbone.name == "bundle"


def test_without_a_configuration_the_defaults_are_used_and_said(
    recording: Recording, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("calm_edge.recording.schema.CONFIG_METADATA", "of.another.program")
    assert recorded_config(recording) == Config()
    assert "contains no configuration" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--spacing-m", "52"), "scale.spacing_m = 52: the distance .* 52 cm are 0.52"),
        (("--spacing-m", "0.0005"), "scale.spacing_m"),
        (("--set", "scale.spacing_m=-1"), "scale.spacing_m = -1"),
        (("--hfov-deg", "1.2"), "hfov_deg = .1.2.: degrees"),
        (("--hfov-deg", "400"), "hfov_deg"),
    ],
)
def test_values_in_other_units_are_refused(
    recording: Recording, options: tuple[str, ...], message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        of_replay(recording, *options)


def test_a_spacing_with_its_unit_is_refused_in_words(capsys: pytest.CaptureFixture[str]) -> None:
    for command in (["record", "--out", "r"], ["import", "a.mp4", "--out", "r"]):
        with pytest.raises(SystemExit):
            build_parser().parse_args([*command, "--spacing-m", "50cm"])
        assert "'50cm' is no number; give metres, such as 0.52" in capsys.readouterr().err
