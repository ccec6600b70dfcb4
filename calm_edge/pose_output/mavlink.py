"""Encode HEARTBEAT, STATUSTEXT, TIMESYNC and ODOMETRY as MAVLink 2 frames.

Format: https://mavlink.io/en/guide/serialization. Fields are packed little-endian, larger types
first, in the order of the message definitions.
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
# frame around a payload: header of 10 and checksum of 2 bytes
FRAME_BYTES = 12
STATUS_TEXT_BYTES, MAX_STATUS_TEXTS = 50, 4

NAN = math.nan
UNKNOWN_COVARIANCE: tuple[float, ...] = (NAN,) + (0.0,) * 20


class Severity(IntEnum):
    """The values of MAV_SEVERITY in use."""

    WARNING = 4
    NOTICE = 5
    INFO = 6


class SystemState(IntEnum):
    """The values of MAV_STATE in use.

    BOOT: no pose yet. CRITICAL: no pose is sent, it is lost or not metric. POWEROFF: stopping.
    """

    BOOT = 1
    ACTIVE = 4
    CRITICAL = 5
    POWEROFF = 7


class Message(Protocol):
    """A message: its payload, id and CRC_EXTRA, and the struct format of the payload."""

    ID: ClassVar[int]
    CRC_EXTRA: ClassVar[int]
    FORMAT: ClassVar[str]

    def payload(self) -> bytes:
        """Pack the payload, trailing zeros included."""
        ...


@dataclass(frozen=True, slots=True)
class Heartbeat:
    """HEARTBEAT of an onboard controller."""

    system_state: SystemState

    ID: ClassVar[int] = 0
    CRC_EXTRA: ClassVar[int] = 50
    FORMAT: ClassVar[str] = "<IBBBBB"

    def payload(self) -> bytes:
        fields = (0, TYPE_ONBOARD_CONTROLLER, AUTOPILOT_INVALID, 0, self.system_state, 3)
        return struct.pack(self.FORMAT, *fields)


@dataclass(frozen=True, slots=True)
class StatusText:
    """STATUSTEXT, or one chunk of a longer text: at most 50 bytes of UTF-8.

    text_id: shared by the chunks of a text, 0 for a text in one message. chunk: counts from 0.
    """

    severity: Severity
    text: bytes
    text_id: int = 0
    chunk: int = 0

    ID: ClassVar[int] = 253
    CRC_EXTRA: ClassVar[int] = 83
    FORMAT: ClassVar[str] = "<B50sHB"

    def payload(self) -> bytes:
        return struct.pack(self.FORMAT, self.severity, self.text, self.text_id, self.chunk)


def status_texts(severity: Severity, text: str, text_id: int) -> tuple[StatusText, ...]:
    """Encode a text as one message, or as up to MAX_STATUS_TEXTS chunks with text_id (1 to 65535).

    A chunk that is not full ends the text, so an empty one is added after a full last chunk. In
    chunked texts non-ASCII characters become "?", as chunks could split them. Longer texts are cut.
    """
    text = text.replace("\0", " ")
    whole = text.encode(errors="replace")
    if len(whole) > STATUS_TEXT_BYTES:
        whole = text.encode("ascii", "replace")
    if len(whole) <= STATUS_TEXT_BYTES:
        return (StatusText(severity, whole),)
    limit = MAX_STATUS_TEXTS * STATUS_TEXT_BYTES - 1
    if len(whole) > limit:
        whole = whole[: limit - 3] + b"..."
    pieces = [whole[k : k + STATUS_TEXT_BYTES] for k in range(0, len(whole) + 1, STATUS_TEXT_BYTES)]
    return tuple(StatusText(severity, piece, text_id, k) for k, piece in enumerate(pieces))


@dataclass(frozen=True, slots=True)
class Timesync:
    """TIMESYNC: a request has tc1_ns = 0; in a reply it is the time of the replier.

    ts1_ns: the time of the requester, copied to the reply. target: (system, component) addressed,
    (0, 0) for all; in a reply the requester.
    """

    tc1_ns: int
    ts1_ns: int
    target: tuple[int, int] = (0, 0)

    ID: ClassVar[int] = 111
    CRC_EXTRA: ClassVar[int] = 34
    FORMAT: ClassVar[str] = "<qqBB"

    def payload(self) -> bytes:
        return struct.pack(self.FORMAT, self.tc1_ns, self.ts1_ns, *self.target)

    @classmethod
    def from_payload(cls, payload: bytes) -> Timesync:
        """Unpack a payload, whose trailing zeros may be missing."""
        size = struct.calcsize(cls.FORMAT)
        tc1_ns, ts1_ns, *target = struct.unpack(cls.FORMAT, payload[:size].ljust(size, b"\0"))
        return cls(tc1_ns, ts1_ns, (target[0], target[1]))


@dataclass(frozen=True, slots=True)
class Odometry:
    """ODOMETRY of the body FRD frame in the local FRD frame.

    position: m, local axes. quaternion: (w, x, y, z), local <- body. velocity: m/s, body axes.
    turn_rate: rad/s, body axes. pose_covariance: 21 values, the upper triangle by rows of (x, y, z,
    roll, pitch, yaw), m and rad. velocity_covariance: likewise of (velocity, turn_rate), m/s and
    rad/s. An unknown covariance has NaN as its first value. quality: -1 failed, 0 unknown, 1 worst,
    100 best.
    """

    time_usec: int
    position: tuple[float, ...]
    quaternion: tuple[float, ...]
    velocity: tuple[float, ...]
    turn_rate: tuple[float, ...]
    pose_covariance: tuple[float, ...]
    velocity_covariance: tuple[float, ...]
    reset_counter: int
    quality: int

    ID: ClassVar[int] = 331
    CRC_EXTRA: ClassVar[int] = 91
    FORMAT: ClassVar[str] = "<Q3f4f3f3f21f21fBBBBb"

    def payload(self) -> bytes:
        return struct.pack(
            self.FORMAT,
            self.time_usec,
            *self.position,
            *self.quaternion,
            *self.velocity,
            *self.turn_rate,
            *self.pose_covariance,
            *self.velocity_covariance,
            FRAME_LOCAL_FRD,
            FRAME_BODY_FRD,
            self.reset_counter % 256,
            ESTIMATOR_VISION,
            self.quality,
        )


def wire_bytes(kind: type[Message]) -> int:
    """Return the largest number of bytes that a message of this type takes on the line."""
    return FRAME_BYTES + struct.calcsize(kind.FORMAT)


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
    """CRC-16/MCRF4XX, called X.25 by MAVLink."""
    crc = 0xFFFF
    for byte in data:
        crc = crc >> 8 ^ _CRC_TABLE[(crc ^ byte) & 0xFF]
    return crc


class Encoder:
    """Encoder for one sender; counts the sequence number of its messages."""

    def __init__(self, system_id: int = 1, component_id: int = COMPONENT_VISUAL_ODOMETRY) -> None:
        self._sender = (system_id, component_id)
        self._sequence = 0

    def encode(self, message: Message) -> bytes:
        """Return the unsigned MAVLink 2 frame, without trailing zeros in the payload."""
        payload = message.payload()
        # the first byte is sent even if zero
        payload = payload[:1] + payload[1:].rstrip(b"\0")
        low, high = message.ID & 0xFFFF, message.ID >> 16
        header = struct.pack(
            "<BBBBBBHB", len(payload), 0, 0, self._sequence, *self._sender, low, high
        )
        self._sequence = (self._sequence + 1) % 256
        crc = checksum(header + payload + bytes([message.CRC_EXTRA]))
        return bytes([MAGIC]) + header + payload + struct.pack("<H", crc)
