"""Why poses are not metric, as the monitor reads it, and which are held back."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from calm_edge.daemon.hub import unscaled_without
from calm_edge.daemon.hub_status import take_status
from calm_edge.daemon.result import RecordResult
from calm_edge.recording.health import WriterHealth
from calm_edge.types import Metre, PoseSample, PoseStatus

ALIKE = Metre(reason="both pictures look alike")


def no_metre(**result: Any) -> str:
    link: Any = SimpleNamespace(
        given_up=False, waiting=0, overtaken=0, left_to_map=[], lost=[], unsolved=[], in_flight=0,
        frames_lost=0, attaching=0, refused="",
    )  # fmt: skip
    outputs: Any = SimpleNamespace(faults=lambda: (), lost=dict)
    status = take_status(
        RecordResult(**{"spacing_m": 0.5, "submaps": 3} | result), link, link, outputs,
        WriterHealth("", 0, 0, 0, 0.0, 0.0), (), now_ns=0, frame_ns=(0, 0), pose_ns=0, stage_ms={},
    )  # fmt: skip
    return status.no_metre


@pytest.mark.parametrize(
    ("result", "text"),
    [
        ({"metre": Metre(0.02), "pose_status": PoseStatus.LIVE}, ""),
        ({"metre": ALIKE, "pose_status": PoseStatus.LOST}, ""),
        ({"metre": ALIKE, "pose_status": PoseStatus.UNSCALED}, f"no metre: {ALIKE.reason}"),
        # no window is solved yet, but those that failed tell why
        ({"metre": ALIKE, "submaps": 0}, f"no metre: {ALIKE.reason}"),
        ({"submaps": 0}, ""),
        (
            {"metre": Metre(0.02), "pose_status": PoseStatus.UNSCALED},
            "no metre: the newest sub-map does not show it",
        ),
        ({"metre": ALIKE, "pose_status": PoseStatus.UNSCALED, "spacing_m": 0.0}, ""),
    ],
)
def test_the_reason_is_that_of_the_drive_or_of_its_newest_submap(
    result: dict[str, Any], text: str
) -> None:
    assert no_metre(**result) == text


@pytest.mark.parametrize("status", list(PoseStatus))
def test_poses_of_earlier_submaps_are_held_back_once_the_drive_has_no_metre(
    status: PoseStatus,
) -> None:
    sample = PoseSample(0, np.eye(4), np.zeros(3), np.eye(6), 0, status, scale_log_sigma=0.01)
    assert unscaled_without(Metre(0.3, "too straight"), sample) is sample
    held = unscaled_without(ALIKE, sample)
    assert not held.status.usable
    assert (held.status is PoseStatus.LOST) == (status is PoseStatus.LOST)
    assert not status.usable or np.isnan(held.with_drift()[0]).all()
