"""A serial line on which everything that `record` sends is heard."""

from __future__ import annotations

import os
import re
import struct
import threading
from types import TracebackType
from typing import Self

from calm_edge.pose_output.mavlink import Message, Odometry, StatusText
from calm_edge.pose_output.mavlink_parser import MavlinkParser


class SerialLine:
    """Pseudo-terminal, read in a thread while the context is open. port: name of its near end."""

    def __init__(self) -> None:
        self._far, self._near = os.openpty()
        self.port = os.ttyname(self._near)
        self._data = bytearray()
        self._thread = threading.Thread(target=self._read, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        # the reader ends when no process has the near end open any more
        os.close(self._near)
        self._thread.join()
        os.close(self._far)

    def _read(self) -> None:
        try:
            while data := os.read(self._far, 1 << 16):
                self._data += data
        except OSError:
            return  # EIO: the near end is closed

    def payloads(self, kind: type[Message]) -> list[bytes]:
        """Payloads of all messages of one type heard, zeros at their ends restored."""
        size = struct.calcsize(kind.FORMAT)
        found = MavlinkParser((kind,)).feed(bytes(self._data))
        return [message.payload.ljust(size, b"\0") for message in found]

    def qualities(self) -> list[int]:
        """Quality of each ODOMETRY heard, in percent; -1: failed."""
        return [struct.unpack(Odometry.FORMAT, p)[-1] for p in self.payloads(Odometry)]

    def states(self) -> tuple[str, ...]:
        """States of the daemon in order of appearance, from the status texts heard."""
        fields = [struct.unpack(StatusText.FORMAT, p) for p in self.payloads(StatusText)]
        texts = [text.rstrip(b"\0").decode("utf-8", "replace") for _, text, *_ in fields]
        found = [re.match(r"calm-edge (\w+)", text) for text in texts]
        return tuple(dict.fromkeys(match[1] for match in found if match))
