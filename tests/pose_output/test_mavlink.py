"""The encoder against pymavlink, field by field and byte by byte."""

from __future__ import annotations

import math
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as peer

from calm_edge.pose_output.mavlink import (
    UNKNOWN_COVARIANCE,
    Encoder,
    Heartbeat,
    Message,
    Odometry,
    Severity,
    StatusText,
    SystemState,
    Timesync,
    checksum,
    status_texts,
    wire_bytes,
)

COVARIANCE = tuple(0.5 + k for k in range(21))
VELOCITY_COVARIANCE = tuple(100.25 + k for k in range(21))


def odometry(**changes: Any) -> Odometry:
    fields: dict[str, Any] = {
        "time_usec": 123_456_789_012,
        "position": (1.5, -2.25, 3.125),
        "quaternion": (0.5, -0.5, 0.5, 0.5),
        "velocity": (10.0, 0.25, -0.75),
        "turn_rate": (0.125, -0.5, 0.0625),
        "pose_covariance": COVARIANCE,
        "velocity_covariance": VELOCITY_COVARIANCE,
        "reset_counter": 3,
        "quality": 100,
    }
    return Odometry(**fields | changes)


def decode(data: bytes) -> Any:
    """Decode the one message in the bytes, with its checksum."""
    (message,) = peer.MAVLink(None).parse_buffer(data)
    assert message.get_type() != "BAD_DATA", message
    return message


def test_odometry_field_by_field() -> None:
    data = Encoder().encode(odometry())
    got = decode(data)
    assert got.get_type() == "ODOMETRY"
    assert got.time_usec == 123_456_789_012
    assert (got.frame_id, got.child_frame_id) == (
        peer.MAV_FRAME_LOCAL_FRD,
        peer.MAV_FRAME_BODY_FRD,
    )
    assert (got.x, got.y, got.z) == (1.5, -2.25, 3.125)
    assert tuple(got.q) == (0.5, -0.5, 0.5, 0.5)
    assert (got.vx, got.vy, got.vz) == (10.0, 0.25, -0.75)
    assert (got.rollspeed, got.pitchspeed, got.yawspeed) == (0.125, -0.5, 0.0625)
    assert tuple(got.pose_covariance) == COVARIANCE
    assert tuple(got.velocity_covariance) == VELOCITY_COVARIANCE
    assert got.reset_counter == 3
    assert got.estimator_type == peer.MAV_ESTIMATOR_TYPE_VISION
    assert got.quality == 100
    assert len(data) == wire_bytes(Odometry) == 245


@pytest.mark.parametrize("quality", [-1, 0, 1, 100])
def test_quality_keeps_its_sign(quality: int) -> None:
    assert decode(Encoder().encode(odometry(quality=quality))).quality == quality


def test_the_reset_counter_wraps_as_a_byte() -> None:
    assert decode(Encoder().encode(odometry(reset_counter=257))).reset_counter == 1


def test_unknown_covariance_begins_with_nan() -> None:
    unknown = odometry(pose_covariance=UNKNOWN_COVARIANCE, velocity_covariance=UNKNOWN_COVARIANCE)
    got = decode(Encoder().encode(unknown))
    for covariance in (got.pose_covariance, got.velocity_covariance):
        assert math.isnan(covariance[0])
        assert len(covariance) == 21


def test_heartbeat_field_by_field() -> None:
    got = decode(Encoder(system_id=7).encode(Heartbeat(SystemState.ACTIVE)))
    assert got.get_type() == "HEARTBEAT"
    assert got.type == peer.MAV_TYPE_ONBOARD_CONTROLLER
    assert got.autopilot == peer.MAV_AUTOPILOT_INVALID
    assert (got.base_mode, got.custom_mode, got.mavlink_version) == (0, 0, 3)
    assert got.system_status == peer.MAV_STATE_ACTIVE
    assert got.get_srcSystem() == 7
    assert got.get_srcComponent() == peer.MAV_COMP_ID_VISUAL_INERTIAL_ODOMETRY


def test_enums_match_the_standard() -> None:
    assert {s.name: s.value for s in SystemState} == {
        s.name: getattr(peer, f"MAV_STATE_{s.name}") for s in SystemState
    }
    assert {s.name: s.value for s in Severity} == {
        s.name: getattr(peer, f"MAV_SEVERITY_{s.name}") for s in Severity
    }


def reassembled(messages: tuple[StatusText, ...]) -> tuple[str, list[tuple[int, int]]]:
    """Join the chunks as a receiver does: a chunk with a zero byte ends the text."""
    parts = [decode(Encoder().encode(m)) for m in messages]
    fields = [m.payload()[1:51] for m in messages]
    assert all(b"\0" not in field for field in fields[:-1])
    assert len(parts) == 1 or b"\0" in fields[-1]
    assert {p.severity for p in parts} == {4}
    text = b"".join(fields).rstrip(b"\0").decode()
    # pymavlink decodes ASCII only
    assert "".join(p.text for p in parts) == text or not text.isascii()
    return text, [(p.id, p.chunk_seq) for p in parts]


@pytest.mark.parametrize(
    ("text", "received", "ids"),
    [
        ("pose lost", "pose lost", [(0, 0)]),
        ("", "", [(0, 0)]),
        ("x" * 50, "x" * 50, [(0, 0)]),
        ("é" * 25, "é" * 25, [(0, 0)]),
        ("x" * 49 + "yz", "x" * 49 + "yz", [(7, 0), (7, 1)]),
        # an empty chunk ends a text whose last chunk is full
        ("x" * 100, "x" * 100, [(7, 0), (7, 1), (7, 2)]),
        ("é" * 26, "?" * 26, [(0, 0)]),
        ("né" * 40, "n?" * 40, [(7, 0), (7, 1)]),
        ("a\0b", "a b", [(0, 0)]),
        ("x" * 199, "x" * 199, [(7, k) for k in range(4)]),
        ("x" * 5000, "x" * 196 + "...", [(7, k) for k in range(4)]),
    ],
)
def test_texts_of_any_length_are_reassembled(
    text: str, received: str, ids: list[tuple[int, int]]
) -> None:
    assert reassembled(status_texts(Severity.WARNING, text, 7)) == (received, ids)


def test_timesync_reply() -> None:
    data = Encoder().encode(Timesync(tc1_ns=-5, ts1_ns=2**40, target=(3, 1)))
    got = decode(data)
    assert (got.tc1, got.ts1) == (-5, 2**40)
    # the dialect of pymavlink predates the target fields
    assert data[-4:-2] == bytes([3, 1])
    assert Timesync.from_payload(data[10:-2]) == Timesync(-5, 2**40, (3, 1))


@pytest.mark.parametrize(
    ("message", "twin"),
    [
        (Heartbeat(SystemState.BOOT), peer.MAVLink_heartbeat_message(18, 8, 0, 0, 1, 3)),
        (
            StatusText(Severity.INFO, b"hello", 258, 3),
            peer.MAVLink_statustext_message(6, b"hello", 258, 3),
        ),
        (Timesync(0, 0), peer.MAVLink_timesync_message(0, 0)),
        (Timesync(9, 0), peer.MAVLink_timesync_message(9, 0)),
        (
            odometry(quality=0),
            peer.MAVLink_odometry_message(
                *(123_456_789_012, 20, 12, 1.5, -2.25, 3.125, (0.5, -0.5, 0.5, 0.5)),
                *(10.0, 0.25, -0.75, 0.125, -0.5, 0.0625),
                *(COVARIANCE, VELOCITY_COVARIANCE, 3, 2, 0),
            ),
        ),
    ],
)
def test_bytes_equal_those_of_pymavlink(message: Message, twin: Any) -> None:
    link = peer.MAVLink(None, srcSystem=1, srcComponent=197)
    assert Encoder().encode(message) == bytes(twin.pack(link))


def test_trailing_zeros_are_left_out_but_for_one_byte() -> None:
    assert Encoder().encode(Timesync(0, 0))[1] == 1
    assert Encoder().encode(Timesync(0x0100, 0))[1] == 2
    assert Encoder().encode(odometry(quality=0))[1] == 232


def test_the_sequence_number_counts_messages_and_wraps() -> None:
    encoder = Encoder()
    sequences = [encoder.encode(Heartbeat(SystemState.ACTIVE))[4] for _ in range(258)]
    assert sequences == [k % 256 for k in range(258)]


def test_checksum_of_the_standard_check_string() -> None:
    # the published check value of CRC-16/MCRF4XX
    assert checksum(b"123456789") == 0x6F91
