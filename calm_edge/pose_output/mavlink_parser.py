"""Extract MAVLink messages of given types from a byte stream with arbitrary other content."""

from __future__ import annotations

import re
from dataclasses import dataclass

from calm_edge.pose_output.mavlink import MAGIC, Message, checksum

_MAGIC_1 = 0xFE
_HEADER, _HEADER_1, _CRC, _SIGNATURE = 10, 6, 2, 13
_SIGNED = 0x01


@dataclass(frozen=True, slots=True)
class Received:
    """A message with a valid checksum. payload: as sent, so trailing zeros may be missing."""

    system_id: int
    component_id: int
    message_id: int
    payload: bytes


class MavlinkParser:
    """Incremental parser of MAVLink 1 and 2; buffers the bytes of an incomplete message.

    known: the types of messages to find. Their headers are searched for at every byte, and other
    messages are not parsed, so bytes that resemble another header never hide a message. Signatures
    are skipped without a check.
    """

    def __init__(self, known: tuple[type[Message], ...]) -> None:
        self._crc_extra = {kind.ID: kind.CRC_EXTRA for kind in known}
        self._start = re.compile(b"|".join(_headers(i) for i in self._crc_extra), re.DOTALL)
        self._pending = b""

    def feed(self, data: bytes) -> list[Received]:
        """Return the messages that are complete with these bytes."""
        data = self._pending + data
        found: list[Received] = []
        at = 0
        while (start := self._start.search(data, at)) is not None:
            size, message = self._message(data, start.start())
            if start.start() + size > len(data):
                self._pending = data[start.start() :]
                return found
            if message is not None:
                found.append(message)
            at = start.start() + (size if message is not None else 1)
        # keep the last bytes, which may be an incomplete header
        self._pending = data[max(at, len(data) - _HEADER + 1) :]
        return found

    def _message(self, data: bytes, at: int) -> tuple[int, Received | None]:
        """Return the length of the message that starts at `at`, and the message if it is valid."""
        if data[at] == MAGIC:
            header, sender = _HEADER, data[at + 5 : at + 7]
            message_id = int.from_bytes(data[at + 7 : at + 10], "little")
            signature = _SIGNATURE if data[at + 2] & _SIGNED else 0
        else:
            header, sender, message_id, signature = (
                _HEADER_1,
                data[at + 3 : at + 5],
                data[at + 5],
                0,
            )
        end = at + header + data[at + 1]
        size = end + _CRC + signature - at
        crc = checksum(data[at + 1 : end] + bytes([self._crc_extra[message_id]]))
        if at + size > len(data) or crc != int.from_bytes(data[end : end + _CRC], "little"):
            return size, None
        return size, Received(sender[0], sender[1], message_id, data[at + header : end])


def _headers(message_id: int) -> bytes:
    """Return a regular expression for the header of a message in MAVLink 1 and 2.

    Frames with an incompatibility flag other than the signature's are not matched: the MAVLink
    specification requires receivers to drop them.
    """
    version_2 = re.escape(bytes([MAGIC])) + b".[\x00\x01].{4}"
    patterns = [version_2 + re.escape(message_id.to_bytes(3, "little"))]
    if message_id < 256:
        patterns.append(re.escape(bytes([_MAGIC_1])) + b".{4}" + re.escape(bytes([message_id])))
    return b"|".join(patterns)
