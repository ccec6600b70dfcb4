"""The newest message of each kind, for readers that may be slower than the writer."""

from __future__ import annotations

import threading
from typing import Generic, TypeVar

T = TypeVar("T")


class Board(Generic[T]):
    """Holds the newest message of each kind; an older one that nobody has read yet is replaced.

    So memory is bounded, the writer never waits, and a slow reader gets what is new.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._newest: dict[str, tuple[int, T]] = {}
        self._version = 0
        self._closed = False

    @property
    def closed(self) -> bool:
        return self._closed

    def put(self, kind: str, message: T) -> None:
        """Replace the message of a kind."""
        with self._changed:
            self._version += 1
            self._newest[kind] = self._version, message
            self._changed.notify_all()

    def get(self, kind: str) -> T | None:
        """The newest message of a kind; None without one."""
        with self._changed:
            found = self._newest.get(kind)
            return None if found is None else found[1]

    def clear(self) -> None:
        """Forget all messages: those of an earlier drive."""
        with self._changed:
            self._newest.clear()

    def changes(self, after: int, timeout_s: float) -> tuple[int, list[tuple[str, T]]]:
        """Wait for messages newer than version `after`; return the version and these, by kind.

        In the order in which they were put; none after the timeout or once closed.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._closed or self._version > after, timeout_s)
            items = sorted(self._newest.items(), key=lambda item: item[1][0])
            new = [(kind, message) for kind, (version, message) in items if version > after]
            return self._version, new

    def close(self) -> None:
        """Let no reader wait any longer."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
