"""Bounded queue between the recording threads and the writer thread."""

from __future__ import annotations

import threading
from collections import deque
from typing import Generic, TypeVar

from calm_edge.recording import RecordingError

T = TypeVar("T")


class Mailbox(Generic[T]):
    """FIFO queue of at most `capacity_bytes`; `put` never blocks unless `lossless`.

    When full, it drops the oldest item that is not an image, or the oldest image if it contains
    nothing else. A single item larger than the capacity is accepted.
    """

    def __init__(self, capacity_bytes: int, lossless: bool = False) -> None:
        self._capacity = capacity_bytes
        self._lossless = lossless
        self._changed = threading.Condition()
        # one queue for images and one for other items, to drop the oldest of either kind;
        # entries: (order of arrival, bytes, item)
        self._queues: tuple[deque[tuple[int, int, T]], ...] = (deque(), deque())
        self._arrivals = 0
        self._bytes = 0
        self._dropped = [0, 0]
        self._closed = False
        self._broken = ""

    @property
    def dropped(self) -> tuple[int, int]:
        """Number of items dropped: (items other than images, images)."""
        with self._changed:
            return self._dropped[0], self._dropped[1]

    @property
    def fill(self) -> float:
        """Share of the capacity in use."""
        with self._changed:
            return self._bytes / self._capacity

    @property
    def closed(self) -> bool:
        with self._changed:
            return self._closed

    def put(self, item: T, size: int, is_image: bool) -> None:
        """Add an item of `size` bytes; in lossless mode wait for room.

        Raises RecordingError when closed, or in lossless mode when the disk fails.
        """
        with self._changed:
            if self._closed:
                raise RecordingError("the recording is closed; nothing more can be written to it")
            if self._lossless:
                self._changed.wait_for(lambda: self._broken or self._closed or self._fits(size))
                if self._broken or self._closed:
                    raise RecordingError(
                        self._broken or "the recording was closed before the item could be queued"
                    )
            self._queues[is_image].append((self._arrivals, size, item))
            self._arrivals += 1
            self._bytes += size
            while self._bytes > self._capacity and len(self._queues[0]) + len(self._queues[1]) > 1:
                kind = 0 if self._queues[0] else 1
                self._bytes -= self._queues[kind].popleft()[1]
                self._dropped[kind] += 1
            self._changed.notify_all()

    def take(self, timeout_s: float) -> T | None:
        """Remove and return the oldest item; None after the timeout, or once closed and empty."""
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
        """Wait until closed; False after the timeout."""
        with self._changed:
            return self._changed.wait_for(lambda: self._closed, timeout_s)

    def set_broken(self, reason: str) -> None:
        """Store the error that prevents writing (empty: recovered); wake waiting `put` calls."""
        with self._changed:
            self._broken = reason
            self._changed.notify_all()

    def close(self) -> None:
        """Accept no more items; those queued can still be taken."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def clear(self) -> int:
        """Drop all queued items; return how many."""
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
