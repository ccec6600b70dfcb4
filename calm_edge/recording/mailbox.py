"""The bounded queue between the threads that record and the one that writes."""

from __future__ import annotations

import threading
from collections import deque
from typing import Generic, TypeVar

from calm_edge.recording.errors import RecordingError

T = TypeVar("T")


class Mailbox(Generic[T]):
    """First in, first out, at most `capacity_bytes`; `put` never blocks unless `lossless`.

    When full, the oldest item that is not an image goes first; an image goes only when the
    mailbox holds nothing but images. One item larger than the capacity is accepted alone.
    """

    def __init__(self, capacity_bytes: int, lossless: bool = False) -> None:
        self._capacity = capacity_bytes
        self._lossless = lossless
        self._changed = threading.Condition()
        # (order of arrival, bytes, item), by image or not: drops need the oldest of a kind
        self._queues: tuple[deque[tuple[int, int, T]], ...] = (deque(), deque())
        self._arrivals = 0
        self._bytes = 0
        self._dropped = [0, 0]
        self._closed = False
        self._broken = ""

    @property
    def dropped(self) -> tuple[int, int]:
        """(others, images) lost to a full mailbox."""
        with self._changed:
            return self._dropped[0], self._dropped[1]

    @property
    def fill(self) -> float:
        """Bytes held over capacity."""
        with self._changed:
            return self._bytes / self._capacity

    @property
    def closed(self) -> bool:
        with self._changed:
            return self._closed

    def put(self, item: T, size: int, is_image: bool) -> None:
        """Queue an item of `size` bytes; lossless waits for room.

        Raises RecordingError when closed, or in lossless mode when the reader side is broken.
        """
        with self._changed:
            if self._closed:
                raise RecordingError("the recording is closed; nothing more can be written to it")
            if self._lossless:
                self._changed.wait_for(lambda: self._broken or self._closed or self._fits(size))
                if self._broken or self._closed:
                    raise RecordingError(self._broken or "the recording was closed while waiting")
            self._queues[is_image].append((self._arrivals, size, item))
            self._arrivals += 1
            self._bytes += size
            while self._bytes > self._capacity and len(self._queues[0]) + len(self._queues[1]) > 1:
                kind = 0 if self._queues[0] else 1
                self._bytes -= self._queues[kind].popleft()[1]
                self._dropped[kind] += 1
            self._changed.notify_all()

    def take(self, timeout_s: float) -> T | None:
        """The oldest item, or None after the timeout or once closed and empty."""
        with self._changed:
            self._changed.wait_for(lambda: self._closed or any(self._queues), timeout_s)
            waiting = [q for q in self._queues if q]
            if not waiting:
                return None
            _, size, item = min(waiting, key=lambda q: q[0][0]).popleft()
            self._bytes -= size
            self._changed.notify_all()
            return item

    def wait_closed(self, timeout_s: float) -> bool:
        """Sleep until closed or the timeout; True when closed."""
        with self._changed:
            return self._changed.wait_for(lambda: self._closed, timeout_s)

    def set_broken(self, reason: str) -> None:
        """Say why nothing is taken just now (empty: all is well); wakes lossless writers."""
        with self._changed:
            self._broken = reason
            self._changed.notify_all()

    def close(self) -> None:
        """Accept nothing more; what is queued can still be taken."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def clear(self) -> int:
        """Throw away what is queued, counting it as dropped; returns how many."""
        with self._changed:
            counts = [len(q) for q in self._queues]
            for kind, queue in enumerate(self._queues):
                self._dropped[kind] += len(queue)
                queue.clear()
            self._bytes = 0
            self._changed.notify_all()
            return sum(counts)

    def _fits(self, size: int) -> bool:
        return self._bytes + size <= self._capacity or not any(self._queues)
