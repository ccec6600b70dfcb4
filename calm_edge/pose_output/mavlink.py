"""The four MAVLink 2 messages that leave the car, encoded: https://mavlink.io/en/guide/serialization.

Fields are packed little-endian, larger types first, as the message definitions order them.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from enum import IntEnum
from typing import ClassVar, Protocol

MAGIC = 0xFD
FRAME_LOCAL_FRD = 20
FRAME_BODY_FRD = 12
ESTIMATOR_VISION = 2
TYPE_ONBOARD_CONTROLLER = 18
AUTOPILOT_INVALID = 8
COMPONENT_VISUAL_ODOMETRY = 197

NAN = math.nan
UNKNOWN_COVARIANCE = (NAN,) + (0.0,) * 20


class Severity(IntEnum):
    """MAV_SEVERITY, as far as we raise our voice."""

    WARNING = 4
    NOTICE = 5
    INFO = 6


class SystemState(IntEnum):
    """MAV_STATE, as far as we have it. BOOT: no pose yet. CRITICAL: lost."""

    BOOT = 1
    ACTIVE = 4
    CRITICAL = 5


class Message(Protocol):
    """A payload and what the frame around it needs."""

    ID: ClassVar[int]
    CRC_EXTRA: ClassVar[int]

    def payload(self) -> bytes:
        """The whole payload, zeros at its end included."""
        ...


@dataclass(frozen=True, slots=True)
class Heartbeat:
    """HEARTBEAT of an onboard computer."""

    system_state: SystemState

    ID: ClassVar[int] = 0
    CRC_EXTRA: ClassVar[int] = 50

    def payload(self) -> bytes:
        fields = (0, TYPE_ONBOARD_CONTROLLER, AUTOPILOT_INVALID, 0, self.system_state, 3)
        return struct.pack("<IBBBBB", *fields)


@dataclass(frozen=True, slots=True)
class StatusText:
    """STATUSTEXT: text is cut at 50 bytes of UTF-8."""

    severity: Severity
    text: str

    ID: ClassVar[int] = 253
    CRC_EXTRA: ClassVar[int] = 83

    def payload(self) -> bytes:
        # cut between characters, never within one
        text = self.text.encode()[:50].decode(errors="ignore").encode()
        return struct.pack("<B50sHB", self.severity, text, 0, 0)


@dataclass(frozen=True, slots=True)
class Timesync:
    """TIMESYNC. A reply has its sender's own time in tc1_ns and the request's ts1 in ts1_ns."""

    tc1_ns: int
    ts1_ns: int

    ID: ClassVar[int] = 111
    CRC_EXTRA: ClassVar[int] = 34

    def payload(self) -> bytes:
        return struct.pack("<qq", self.tc1_ns, self.ts1_ns)


@dataclass(frozen=True, slots=True)
class Odometry:
    """ODOMETRY, local FRD <- body FRD.

    position: m, local. quaternion: (w, x, y, z), local <- body. velocity: m/s, body.
    pose_covariance: 21 values, the upper triangle by rows of (x, y, z, roll, pitch, yaw),
    m and rad; its first is NaN if unknown. quality: -1 failed, 0 unknown, 1 worst, 100 best.
    """

    time_usec: int
    position: tuple[float, ...]
    quaternion: tuple[float, ...]
    velocity: tuple[float, ...]
    pose_covariance: tuple[float, ...]
    reset_counter: int
    quality: int

    ID: ClassVar[int] = 331
    CRC_EXTRA: ClassVar[int] = 91

    def payload(self) -> bytes:
        return struct.pack(
            "<Q3f4f3f3f21f21fBBBBb",
            self.time_usec,
            *self.position,
            *self.quaternion,
            *self.velocity,
            # we have no angular velocity and no covariance of the velocity
            *(NAN, NAN, NAN),
            *self.pose_covariance,
            *UNKNOWN_COVARIANCE,
            FRAME_LOCAL_FRD,
            FRAME_BODY_FRD,
            self.reset_counter % 256,
            ESTIMATOR_VISION,
            self.quality,
        )


def _crc_table() -> tuple[int, ...]:
    table = []
    for byte in range(256):
        crc = byte
        for _ in range(8):
            crc = crc >> 1 ^ (0x8408 if crc & 1 else 0)
        table.append(crc)
    return tuple(table)


_CRC_TABLE = _crc_table()


def checksum(data: bytes) -> int:
    """CRC-16/MCRF4XX, which MAVLink calls X.25."""
    crc = 0xFFFF
    for byte in data:
        crc = crc >> 8 ^ _CRC_TABLE[(crc ^ byte) & 0xFF]
    return crc


class Encoder:
    """Messages -> bytes of one sender, numbered."""

    def __init__(self, system_id: int = 1, component_id: int = COMPONENT_VISUAL_ODOMETRY) -> None:
        self._sender = (system_id, component_id)
        self._sequence = 0

    def encode(self, message: Message) -> bytes:
        """The MAVLink 2 frame, unsigned, zeros at the payload's end left out."""
        payload = message.payload()
        # the first byte stays, even as a zero
        payload = payload[:1] + payload[1:].rstrip(b"\0")
        low, high = message.ID & 0xFFFF, message.ID >> 16
        header = struct.pack(
            "<BBBBBBHB", len(payload), 0, 0, self._sequence, *self._sender, low, high
        )
        self._sequence = (self._sequence + 1) % 256
        crc = checksum(header + payload + bytes([message.CRC_EXTRA]))
        return bytes([MAGIC]) + header + payload + struct.pack("<H", crc)
