"""Load measurement: pictures, background graph and table."""

from __future__ import annotations

import itertools
import os
from pathlib import Path

import numpy as np
import pytest

from bench.cost import joint_optimum, length
from bench.cost.load import PRIORITY, Run, cpu_seconds, granted, table
from bench.cost.load_pictures import SIZE, enlarged, frames
from calm_edge.config import load
from calm_edge.daemon.result import RecordResult
from calm_edge.daemon.tick_latency import TickLatency
from calm_edge.geometry.flow import corners, follow
from calm_edge.types import PoseStatus
from device.frame import Eye, Frame
from tests.replay.small_drive import write_drive


def test_pictures_are_made_once_at_the_size_of_a_camera(tmp_path: Path) -> None:
    drive = write_drive(tmp_path / "drive", 4)
    made = enlarged(drive, Eye.PRIMARY, tmp_path / "pictures")
    # from the assistant's first to the primary's last, 17 ms later and 300 ms: thirty a second
    assert len(made) == len(enlarged(drive, Eye.ASSISTANT, tmp_path / "pictures")) == 9
    pictures = [Frame(Eye.PRIMARY, 0, 1, p.read_bytes()).gray() for p in made]
    assert all(p.shape == SIZE[::-1] for p in pictures)
    # it moves from each to the next, and not by leaps
    steps = [
        float(np.median(np.linalg.norm(moved - uv, axis=1)[good]))
        for a, b in itertools.pairwise(pictures)
        for uv in [corners(a, 200)]
        for moved, good in [follow(a, b, uv)]
    ]
    assert max(steps) < 3 * min(steps) and min(steps) > 0.5
    made[0].write_bytes(b"kept")
    assert enlarged(drive, Eye.PRIMARY, tmp_path / "pictures")[0].read_bytes() == b"kept"


def test_frames_come_thirty_times_a_second_there_and_back(tmp_path: Path) -> None:
    pictures = [tmp_path / name for name in "abc"]
    for path in pictures:
        path.write_text(path.name)
    given = list(frames(pictures, Eye.ASSISTANT, 9))
    assert b"".join(f.image for f in given if isinstance(f.image, bytes)) == b"abcbabcba"
    assert [f.sequence for f in given] == list(range(9))
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
def test_each_requirement_is_judged(
    lost: int, late_ms: float, age_ms: float | None, share: float, kept: list[bool]
) -> None:
    result = RecordResult(frames=[30, 30], tick=TickLatency(100, 0.1, late_ms, 9.0))
    if age_ms is not None:
        result.note_pose(PoseStatus.LIVE, age_ms)
    made = table([Run("inference", 60, lost, share, 0.5, 1.0, result)], "command")
    assert [check.passed for check in made.checks] == kept


def test_the_priority_is_the_packages_and_asked_for_by_a_thread_that_is_gone() -> None:
    assert load(Path("deploy/calm-edge.toml")).capture.realtime_priority == PRIORITY
    assert granted(PRIORITY) in (0, PRIORITY)
    assert os.sched_getscheduler(0) == os.SCHED_OTHER
    # the kernel has none above 99
    assert granted(100) == 0


def test_the_processor_time_of_a_process_is_its_own() -> None:
    measured, own = cpu_seconds(os.getpid()), sum(os.times()[:2])
    assert own - 0.1 < measured <= own + 0.1
