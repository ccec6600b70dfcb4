"""`calm-edge map` of several recordings: what it refuses, and the command for each drive."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calm_edge.cli import build_parser, main
from calm_edge.commands import map as map_command
from calm_edge.commands.map_drives import agreed_configs, part_command, unique_names
from calm_edge.config import Config, merge
from calm_edge.offline import drive_part
from calm_edge.offline.drive import Drive
from calm_edge.offline.drive_part import depth_of, read_part
from calm_edge.offline.unfinished import Unfinished
from calm_edge.recording.window_record import WindowRecord
from calm_edge.recording.writer import RecordingWriter
from device.frame import Eye
from tests.interchange.export.drives import EVERY, FRAMES, LENSES, update, write_recording


@pytest.fixture
def recordings(tmp_path: Path) -> list[str]:
    """A recording with a spacing and one without."""
    for name, spacing_m in (("monday", 0.5), ("tuesday", 0.0)):
        config = merge(Config(), {"scale": {"spacing_m": spacing_m}})
        RecordingWriter(tmp_path / name, config).close()
    return [str(tmp_path / "monday"), str(tmp_path / "tuesday")]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (["--truth", "x"], "--truth: 1 for 2 recordings; give one for each"),
        (
            ["--gps", "x", "--gps", "y", "--gps", "z"],
            "--gps: 3 for 2 recordings; give one for each",
        ),
        (["--gps", "x.gpx"], "x.gpx: cannot be read (No such file or directory)"),
        (["--truth", "x", "--truth", "y"], "x: no such folder"),
        (["--part"], "--part: is for a map of one recording"),
        (["--rerun-model", "x"], "--rerun-model: is for a map of one recording"),
        ([], "tuesday: has no scale.spacing_m, others have one"),
    ],
)
def test_what_does_not_go_together_is_refused_in_a_line(
    recordings: list[str],
    tmp_path: Path,
    change: list[str],
    words: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    one = ["--set", "scale.spacing_m=0.5"] if change else []
    assert main(["map", *recordings, "--out", str(tmp_path / "out"), *one, *change]) == 1
    shown = capsys.readouterr().err
    assert words in shown and shown.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("option", ["truth", "gps"])
def test_a_map_of_one_recording_takes_one_of_each(
    recordings: list[str], tmp_path: Path, option: str, capsys: pytest.CaptureFixture[str]
) -> None:
    twice = [f"--{option}", "x", f"--{option}", "y"]
    assert main(["map", recordings[0], "--out", str(tmp_path / "out"), *twice]) == 1
    assert f"--{option}: 2 for one recording; give one" in capsys.readouterr().err


def test_a_recording_is_named_once(
    recordings: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["map", recordings[0], recordings[0], "--out", str(tmp_path / "out")]) == 1
    assert "named twice" in capsys.readouterr().err


def test_an_unfinished_map_is_continued_or_replaced_on_request(
    recordings: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "out" / "parts").mkdir(parents=True)
    one = ["--set", "scale.spacing_m=0.5"]
    assert main(["map", *recordings, "--out", str(tmp_path / "out"), *one]) == 1
    assert "continue it with --resume, or replace it with --force" in capsys.readouterr().err


def test_drives_of_equal_names_are_numbered_and_parts_are_commands(tmp_path: Path) -> None:
    names = unique_names([Path("a/drive"), Path("b/drive"), Path("c/other.mcap")])
    assert names == ["drive-0", "drive-1", "other"]
    command = part_command(tmp_path / "rec", tmp_path / "part", ["mapping.grid=20"])
    assert command[:2] == ["-m", "calm_edge.cli"] and "--resume" not in command
    (tmp_path / "part").mkdir()
    command = part_command(tmp_path / "rec", tmp_path / "part", ["mapping.grid=20"], "preview")
    arguments = build_parser().parse_args(command[2:])
    assert arguments.part and arguments.resume and arguments.set == ["mapping.grid=20"]
    assert arguments.recording == [tmp_path / "rec"] and arguments.quality == "preview"


def test_the_part_that_the_command_makes_is_the_one_that_is_joined(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_recording(tmp_path / "rec")
    solved = update(LENSES, 0.01)
    n = len(solved.submap.t_ns)
    window = WindowRecord(
        *(0, solved.submap.n_primary, 0, False),
        ids=np.arange(n),
        eyes=np.repeat(list(Eye), n // 2),
        sequences=np.tile(np.arange(0, FRAMES, EVERY), 2),
        t_ns=solved.submap.t_ns,
    )
    drive = Drive([window], [solved], solved.trajectory)

    def placed(_recording: Any, _config: Any, work: Unfinished, *, again: bool) -> Drive:
        work.place(drive)
        return drive

    depth = np.ones((n, 4, 6), np.float32)
    monkeypatch.setattr(map_command, "placed_drive", placed)
    monkeypatch.setattr(drive_part, "densified", lambda *_: iter([(depth, depth)]))
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    settings = ["mapping.grid=20"]
    command = part_command(path, tmp_path / "part", settings, "preview")
    assert main(command[2:]) == 0
    # several drives are worked on at once
    assert "calm-edge: part: depth of sub-maps: 1 of 1" in capsys.readouterr().err
    (config,) = agreed_configs([path], settings, "preview")
    # a setting goes over the preset
    assert config.mapping.grid == 20 and config.backbone.depth_every == 3
    part = read_part(tmp_path / "part", path, config)
    assert [update.submap.id for update in part.placed.drive.updates] == [0]
    found = depth_of(part, 0)
    assert found is not None and found[0].shape == depth.shape
