"""Messages between a recording and its live page, on a Unix stream socket.

Each is two lengths of four bytes, a JSON object with its `kind`, and bytes, e.g. of a picture.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from calm_edge.recording.schema import finite

_LENGTHS = struct.Struct("!II")
# of either part; more is no message
LIMIT_BYTES = 32 << 20


class Stream(Protocol):
    """What messages are read from: a buffered file, or the like."""

    def read(self, size: int, /) -> bytes:
        """Read `size` bytes, fewer only at the end."""
        ...


class WireError(Exception):
    """Bytes that are no message."""


@dataclass(frozen=True, slots=True)
class Message:
    """A message of one kind. content: what JSON can hold. data: bytes beside it."""

    kind: str
    content: Mapping[str, Any]
    data: bytes = b""

    def encoded(self) -> bytes:
        """Encode the message; numbers that JSON does not have become null."""
        text = json.dumps({"kind": self.kind, **finite(self.content)}, allow_nan=False).encode()
        return _LENGTHS.pack(len(text), len(self.data)) + text + self.data


def receive(stream: Stream) -> Message | None:
    """Read the next message; None at the end of the stream. Raises WireError, OSError."""
    head = stream.read(_LENGTHS.size)
    if not head:
        return None
    if len(head) < _LENGTHS.size:
        raise WireError("cut off")
    sizes = _LENGTHS.unpack(head)
    if max(sizes) > LIMIT_BYTES:
        raise WireError(f"{max(sizes)} bytes announced")
    text, data = (stream.read(size) for size in sizes)
    if (len(text), len(data)) != sizes:
        raise WireError("cut off")
    try:
        content = json.loads(text)
        kind = content.pop("kind")
    except (ValueError, RecursionError, AttributeError, KeyError, TypeError):
        raise WireError("no JSON object with a kind") from None
    if not isinstance(kind, str):
        raise WireError("the kind is no text")
    return Message(kind, content, data)
