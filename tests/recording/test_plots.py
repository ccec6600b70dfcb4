"""Which numbers are published as arrays."""

from __future__ import annotations

import math
import struct

import pytest

from calm_edge.recording import plots, schema
from calm_edge.recording.schema import LogMessage

EYE = {"focal_px": 500.0, "focal_low_px": 490.0, "focal_high_px": 510.0}
KIT = {"primary": EYE, "assistant": EYE, "time_offset_ms": 3, "length_sigma_percent": 1.5}


def numbers(message: LogMessage) -> list[float]:
    n = struct.unpack_from("<I", message.data, 12)[0]
    return list(struct.unpack_from(f"<{n}d", message.data, 20))


def test_every_number_of_the_kit_is_in_the_array_of_its_topic() -> None:
    found = {m.topic: numbers(m) for m in plots.messages(schema.KIT, 5, KIT)}
    assert found == {
        "/plot/primary/focal_px": [500, 490, 510],
        "/plot/assistant/focal_px": [500, 490, 510],
        "/plot/length_sigma_percent": [1.5],
        "/plot/time_offset_ms": [3],
    }


@pytest.mark.parametrize("unknown", [None, math.nan, math.inf])
def test_arrays_with_an_unknown_number_are_left_out(unknown: float | None) -> None:
    eye = EYE | {"focal_low_px": unknown, "focal_high_px": unknown}
    found = plots.messages(schema.KIT, 5, {"primary": EYE, "assistant": eye, "time_offset_ms": 3})
    assert [m.topic for m in found] == ["/plot/primary/focal_px", "/plot/time_offset_ms"]


def test_health_has_plots_at_its_own_time_and_other_topics_have_none() -> None:
    health = {"pose_age_ms": None, "tick": {"p99_ms": 2.5}, "queues": {}}
    (message,) = plots.messages(schema.HEALTH, 7, health)
    assert (message.topic, message.t_ns, numbers(message)) == ("/plot/tick_p99_ms", 7, [2.5])
    assert plots.messages(schema.STATUS, 7, health) == []
