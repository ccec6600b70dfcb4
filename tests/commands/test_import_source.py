"""`calm-edge import`, from its arguments to a recording that can be replayed."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from calm_edge.cli import main
from calm_edge.daemon.source import of_recording
from calm_edge.geometry.camera import Perspective
from calm_edge.interchange.calibration import formats
from calm_edge.interchange.calibration.calibration import CalibratedCamera, Calibration
from calm_edge.recording.reader import Recording
from device.frame import Eye
from tests.interchange.moving import pictures, write_video

SET = ["--set", "recording.keep_free_gib=0", "--set", "recording.keep_free_percent=0"]


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    t = np.arange(12) / 30
    return write_video(tmp_path_factory.mktemp("video") / "a.mp4", t, pictures(t))


def test_two_videos_become_a_recording(
    tmp_path: Path, file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "rec"
    command = ["import", str(file), str(file), "--out", str(out), "--offset-s", "0.01"]
    assert main([*command, "--spacing-m", "0.5", *SET]) == 0
    shown = capsys.readouterr().out
    assert "frames      12 primary, 12 assistant" in shown
    assert "assumed     clock offset +0.01 s and no drift, as given" in shown
    recording = Recording(out)
    assert recording.config.scale.spacing_m == 0.5
    stamps = [recording.frame_times(eye) for eye in Eye]
    assert abs(stamps[1] - stamps[0] - 10_000_000).max() < 1000
    assert of_recording(Recording(out), paced=False).is_replay


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["missing.mp4", "missing.mp4"], "missing.mp4: no such file"),
        (["{file}"], "no spacing"),
        (["{file}", "{file}"], "cannot be related"),
        (["{file}", "{file}", "--quality", "0"], "--quality 0: must be from 1 to 100"),
        (["{file}", "{file}", "--rotate", "90"], "--rotate: give 2 values"),
        (["{file}", "{file}", "{file}"], "3 sources"),
        ([__file__, __file__], "not a format that can be imported"),
    ],
)
def test_what_is_refused_leaves_one_line_and_no_recording(
    tmp_path: Path,
    file: Path,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    message: str,
) -> None:
    words = [word.format(file=file) for word in arguments]
    assert main(["import", *words, "--out", str(tmp_path / "rec"), *SET]) == 1
    printed = capsys.readouterr().err.strip()
    assert message in printed and len(printed.splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_without_pyav_the_remedy_is_named(
    tmp_path: Path,
    file: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    assert main(["import", str(file), str(file), "--out", str(tmp_path / "rec"), *SET]) == 1
    assert "pip install 'calm-edge[import]'" in capsys.readouterr().err


def test_a_calibration_is_in_the_configuration_for_the_map(tmp_path: Path, file: Path) -> None:
    lens = Perspective.from_hfov(70.0, 320, 240)
    cameras = (CalibratedCamera(lens, "test"), CalibratedCamera(lens, "test"))
    (path,) = formats.write("colmap", tmp_path / "calibration", Calibration(cameras))
    out = tmp_path / "rec"
    command = ["import", str(file), str(file), "--out", str(out), "--offset-s", "0.01"]
    assert main([*command, "--spacing-m", "0.5", "--calibration", str(path), *SET]) == 0
    assert [entry.fx for entry in Recording(out).config.calibration.cameras] == [lens.fx, lens.fx]


def test_a_full_disk_is_one_line_and_leaves_nothing(tmp_path: Path, file: Path) -> None:
    command = ["import", str(file), str(file), "--out", str(tmp_path / "rec"), "--offset-s", "0"]
    full = ["--set", "recording.keep_free_gib=1e6"]
    run = subprocess.run(
        [sys.executable, "-m", "calm_edge.cli", *command, *full], capture_output=True, text=True
    )
    (line,) = (text for text in run.stderr.splitlines() if "No space left" in text)
    assert run.returncode == 1 and line.endswith("free space or repair the disk")
    assert list(tmp_path.iterdir()) == []
