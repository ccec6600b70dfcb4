"""A clock that stands still until a test moves it."""

from __future__ import annotations


class ManualClock:
    """A Clock that advances only by sleep_until_ns() and advance()."""

    def __init__(self, now_ns: int = 0) -> None:
        self._now_ns = now_ns

    def now_ns(self) -> int:
        return self._now_ns

    def sleep_until_ns(self, t_ns: int) -> None:
        self._now_ns = max(self._now_ns, t_ns)

    def advance(self, duration_ns: int) -> None:
        """Advance the clock by duration_ns >= 0."""
        self._now_ns += duration_ns
