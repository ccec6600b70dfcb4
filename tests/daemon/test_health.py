"""The health message and the status line of one second."""

from __future__ import annotations

import dataclasses
import json

import pytest

from calm_edge.daemon.health import Health, time_left
from calm_edge.daemon.state import Standing, State
from calm_edge.daemon.tick_latency import TickLatency
from calm_edge.recording.health import Space, WriterHealth
from device.thermal import Thermal

GIB = 1 << 30
WRITER = WriterHealth("", 0, 0, 0, 0.01, 2.0, Space(62 * GIB, 2 * GIB, 6e6))
HEALTH = Health(
    standing=Standing(State.RUNNING),
    shed="nothing left out",
    tick=TickLatency(100, 0.1, 1.23456, 4.0),
    late_ticks=0,
    counts={"primary_frames": 600, "assistant_frames": 598, "windows": 16, "submaps": 15},
    drops={"missed_by_the_cameras": 0, "not_tracked": 0},
    queues={"estimator_windows": 1},
    stage_ms={"infer": 812.34567},
    pose_age_ms=43.21,
    writer=WRITER,
    thermal=Thermal(61.2, False),
)


def test_the_status_line() -> None:
    assert HEALTH.line() == (
        "RUNNING: 600+598 frames, none lost, 15 of 16 sub-maps, pose 43 ms old, 61 °C, "
        "2 h 58 min left"
    )
    bad = dataclasses.replace(
        HEALTH,
        standing=Standing(State.DEGRADED, ("disk full",)),
        drops={"missed_by_the_cameras": 3, "not_tracked": 0},
        pose_age_ms=None,
        thermal=Thermal(),
    )
    assert bad.line() == (
        "DEGRADED (disk full): 600+598 frames, 3 missed by the cameras, 15 of 16 sub-maps, "
        "2 h 58 min left"
    )


@pytest.mark.parametrize(
    ("space", "error", "text"),
    [
        (Space(2 * GIB, 2 * GIB, 6e6), "", "0 h 00 min left"),
        (
            Space(12 * GIB, 2 * GIB, 6e6, True),
            "",
            "0 h 29 min left, then the oldest drives are removed",
        ),
        (Space(62 * GIB, 2 * GIB, 10.0), "", "weeks left"),
        (Space(62 * GIB, 2 * GIB, 0.0), "", ""),
        (Space(None, 2 * GIB, 6e6), "", ""),
        (Space(62 * GIB, 2 * GIB, 6e6), "disk failed", ""),
    ],
)
def test_the_time_left(space: Space, error: str, text: str) -> None:
    assert time_left(dataclasses.replace(WRITER, error=error, space=space)) == text


def test_the_message_is_plain_json() -> None:
    message = json.loads(json.dumps(HEALTH.message()))
    assert message["state"] == "RUNNING" and message["tick"]["p99_ms"] == 1.235
    assert message["disk"]["left_s"] == pytest.approx(60 * GIB / 6e6)
    assert message["stage_ms"] == {"infer": 812.346} and message["celsius"] == 61.2
