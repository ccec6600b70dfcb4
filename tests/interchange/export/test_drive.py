"""What is exported, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from calm_edge.config import Config
from calm_edge.interchange import InterchangeError
from calm_edge.interchange.export.drive import read_drive
from calm_edge.recording.schema import CLOCK
from calm_edge.recording.time_base import ORIGIN_KEY
from calm_edge.recording.writer import RecordingWriter
from device.frame import Eye, Frame, jpeg
from tests.interchange.export.drives import LENSES, ORIGIN_NS, update, with_map, write_recording


def test_stamps_of_live_cameras_are_dated_by_the_wall_clock(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "rec", Config(), {ORIGIN_KEY: "0"}, lossless=True) as writer:
        writer.write_frame(Frame(Eye.PRIMARY, 0, 10**9, jpeg(np.zeros((8, 8, 3), np.uint8))))
        for day in (0, 20_000):
            reading = {"realtime_ns": 86_400 * 10**9 * day + 7, "monotonic_ns": 5}
            writer.write_status(reading, CLOCK)
        writer.write_update(update(LENSES, 0.01))
    drive = read_drive(tmp_path / "rec")
    assert drive.own_ns(np.array([5]))[0] == 86_400 * 10**9 * 20_000 + 7
    assert drive.stamps == "of the host's wall clock"


def test_without_a_solved_window_there_is_nothing_to_export(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "rec", Config(), lossless=True) as writer:
        for eye in Eye:
            writer.write_frame(Frame(eye, 0, 10**9, jpeg(np.zeros((8, 8, 3), np.uint8))))
    with pytest.raises(InterchangeError, match=r"rec: holds no solved window; run calm-edge map"):
        read_drive(tmp_path / "rec")


def test_a_map_is_refused_with_no_or_another_recording(tmp_path: Path) -> None:
    recording = write_recording(tmp_path / "rec")
    folder = with_map(recording, tmp_path / "map")
    assert read_drive(folder).keyframes.t_ns[0] == read_drive(recording).keyframes.t_ns[0]
    moved = recording.rename(tmp_path / "moved")
    with pytest.raises(InterchangeError, match=r"rec is not there; give it by --recording"):
        read_drive(folder)
    assert read_drive(folder, moved).spacing_m == 0.5
    text = (folder / "trajectory.tum").read_text()
    (folder / "trajectory.tum").write_text(text.replace("0.400", "0.433"))
    with pytest.raises(InterchangeError, match="not at frames of"):
        read_drive(folder, moved)
    (folder / "summary.json").write_text(json.dumps([ORIGIN_NS]))
    with pytest.raises(InterchangeError, match="not a JSON object"):
        read_drive(folder, moved)
