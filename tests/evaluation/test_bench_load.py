"""The load bench: its pictures, its graph, and what it makes of a run."""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from calm_edge.daemon.lateness import Lateness
from calm_edge.daemon.result import RecordResult
from calm_edge.evaluation.bench import joint_optimum, length
from calm_edge.evaluation.bench.load import Run, cpu_seconds, table
from calm_edge.evaluation.bench.load_pictures import SIZE, enlarged, frames
from device.frame import Eye, Frame
from tests.replay.small_drive import write_drive


def test_pictures_are_made_once_at_the_size_of_a_camera(tmp_path: Path) -> None:
    drive = write_drive(tmp_path / "drive", 3)
    made = enlarged(drive, Eye.PRIMARY, tmp_path / "pictures")
    assert [Frame(Eye.PRIMARY, 0, 1, p).bgr().shape for p in made] == [(*SIZE[::-1], 3)] * 3
    # no picture is another's
    assert len(set(made)) == 3
    first = tmp_path / "pictures" / "cam0" / "000000.jpg"
    cv2.imwrite(str(first), np.zeros((4, 4, 3), np.uint8))
    assert enlarged(drive, Eye.PRIMARY, tmp_path / "pictures")[0] == first.read_bytes()


def test_frames_come_thirty_times_a_second_there_and_back() -> None:
    given = list(frames([b"a", b"b", b"c"], Eye.ASSISTANT, 15))
    assert b"".join(f.image[:1] for f in given if isinstance(f.image, bytes)) == b"aaabbbcccbbbaaa"
    assert [f.sequence for f in given] == list(range(15))
    step = np.diff([f.t_ns for f in given])
    assert np.abs(step - 1e9 / 30).max() <= 1


def test_the_graph_is_the_whole_drive_with_its_loops() -> None:
    course = length.drive(10)
    asked = joint_optimum.snapshot(course)
    assert len(asked.state.T_w_p) == course.submaps[-1].primary_ids[-1] + 1


@pytest.mark.parametrize(
    ("lost", "late_ms", "age_ms", "share", "kept"),
    [
        (0, 4.0, 120.0, 0.2, [True] * 4),
        (1, 6.0, 160.0, 0.3, [False] * 4),
        (0, 4.0, None, 0.2, [True, True, False, True]),
    ],
)
def test_each_promise_is_judged(
    lost: int, late_ms: float, age_ms: float | None, share: float, kept: list[bool]
) -> None:
    result = RecordResult(frames=[30, 30], tick=Lateness(100, 0.1, late_ms, 9.0))
    if age_ms is not None:
        result.note_pose(False, age_ms)
    made = table([Run("inference", 60, lost, share, 0.5, 1.0, result)], "command")
    assert [check.passed for check in made.checks] == kept


def test_the_processor_time_of_a_process_is_its_own() -> None:
    told, own = cpu_seconds(os.getpid()), sum(os.times()[:2])
    assert own - 0.1 < told <= own + 0.1
