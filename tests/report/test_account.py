"""What happened on a drive, in sentences: only what is known, with its numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calm_edge.evaluation.estimate import Estimate
from calm_edge.report.account import account, when
from calm_edge.report.drive_log import DriveLog, HealthSeries, Lost
from calm_edge.types import Metre


def straight(length: float = 303.0) -> Estimate:
    T = np.tile(np.eye(4), (101, 1, 1))
    T[:, 2, 3] = np.linspace(0, length, 101)
    t_ns = np.arange(101, dtype=np.int64) * 600_000_000
    sigma = (1.62, 9.0)
    return Estimate("r", t_ns, T, 600, 101, 8, 0.52, (500.0, 600.0), sigma, metre=Metre(0.013))


def test_a_good_drive_has_path_loops_focal_metre_and_frames() -> None:
    log = DriveLog(None, "", 61.0, (610, 609), "0.1.0", {"finished": True})
    path, focal, metre, frames = account(straight(), log, 2)
    assert path == "303 m in 1:01 min, 2 loops closed."
    # nothing is claimed of the focal length that is not observed
    assert focal == "Focal lengths known to 1.6 % (primary), one sigma."
    assert "0.52 m" in metre and "1.3 %" in metre
    assert frames == "610 + 609 frames recorded, none lost."


def test_without_a_spacing_there_is_no_metre() -> None:
    bare = replace(straight(), spacing_m=None)
    sentences = account(bare, DriveLog(), 0)
    assert sentences[0] == "303 spacings in 1:00 min, no loop closed."
    assert not any("metre" in sentence for sentence in sentences)
    worse = replace(straight(), metre=Metre(reason="the car stood still"))
    assert account(worse, DriveLog(), 1)[0] == "303 units in 1:00 min, 1 loop closed."


def test_lost_poses_have_their_time_and_reason() -> None:
    start, tunnel = Lost(-0.2, 1.4), Lost(41.2, 12.0, "primary: too dark")
    (only,) = account(straight(), DriveLog(lost=(start,)), 0)[3:]
    assert only == "No live pose for 1.4 s until the first sub-map."
    many = tuple(Lost(50.0 + k, 0.6) for k in range(3))
    (text,) = account(straight(), DriveLog(lost=(start, tunnel, *many)), 0)[3:]
    assert "15.2 s in all" in text and "12.0 s at 0:41 (primary: too dark)" in text
    assert "and 2 shorter ones" in text


def test_lost_frames_and_heat_are_named() -> None:
    nan = np.full(2, np.nan)
    health = HealthSeries(np.array([0.0, 65.0]), np.array([50.0, 91.0]), nan, nan, nan, nan)
    counts = {"finished": True, "camera_drops": 3, "corrupt": 0, "untracked": 2}
    log = DriveLog(None, "", 61.0, (610, 609), counts=counts, health=health)
    frames, heat = account(straight(), log, 0)[3:]
    assert "3 left out by the cameras, 2 recorded but not tracked" in frames
    assert heat == "The computer was at most 91 °C, at 1:05."
    cut = replace(log, counts={}, health=None)
    assert "not ended" in account(straight(), cut, 0)[3]


@pytest.mark.parametrize(
    ("log", "text"),
    [
        (DriveLog(1_700_000_000.0, "synchronised", 61.0), "2023-11-14 22:13 UTC, 1:01 min"),
        (DriveLog(None, "", 3661.0), "1:01:01 min; without a date in its stamps"),
        (DriveLog(1e30, "synchronised", 61.0), "1:01 min"),
        (DriveLog(), ""),
    ],
)
def test_the_date_is_that_of_the_stamps_if_they_have_one(log: DriveLog, text: str) -> None:
    assert when(log) == text


def test_a_clock_that_was_not_set_is_doubted() -> None:
    assert "clock was not set" in when(DriveLog(1_700_000_000.0, "unsynchronised", 61.0))
