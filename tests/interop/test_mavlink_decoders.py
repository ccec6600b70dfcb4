"""That a decoder which reads otherwise would be noticed."""

from __future__ import annotations

import json
from typing import Any

import pytest

from calm_edge.pose_output.mavlink import Encoder, Timesync
from tests.interop.mavlink_decoders import answer, differences, expected, known


def as_decoded() -> list[dict[str, Any]]:
    """What a faultless decoder would print."""
    lines = []
    for message in known():
        text = json.dumps(expected(message)).replace("NaN", "null")
        lines.append(json.loads(text))
    return lines


SENT = [expected(message) for message in known()]
ODOMETRY = next(k for k, m in enumerate(SENT) if m["name"] == "ODOMETRY")


def test_a_faultless_decoder_differs_in_nothing() -> None:
    assert differences(SENT, as_decoded()) == []


@pytest.mark.parametrize(
    ("key", "value"),
    [("quality", 99), ("x", 1234.51), ("x", None), ("q", [0.5, -0.5, 0.1]), ("vx", -1.5)],
)
def test_a_field_read_wrongly_is_named(key: str, value: object) -> None:
    lines = as_decoded()
    lines[ODOMETRY][key] = value
    (found,) = differences(SENT, lines)
    assert f"ODOMETRY.{key}" in found


def test_a_field_or_a_message_that_is_missing_is_named() -> None:
    lines = as_decoded()
    del lines[ODOMETRY]["reset_counter"]
    assert "reset_counter" in differences(SENT, lines)[0]
    assert "messages sent" in differences(SENT, lines[:-1])[0]


def test_our_own_answer_comes_through_the_line() -> None:
    asked = Encoder(1, 1).encode(Timesync(0, 55, (1, 197)))
    data, now_ns = answer(asked)
    assert Timesync.from_payload(data[10:-2]) == Timesync(now_ns, 55, (1, 1))
