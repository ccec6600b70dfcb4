"""Progress of a long computation, as lines with the time that is left."""

from __future__ import annotations

import time
from collections.abc import Callable

# time between two lines
EVERY_S = 2.0


class Progress:
    """Counts finished items, and prints a line for the first, for the last, and every few seconds.

    what: of the computation, e.g. `solving windows`. total: number of items, None if unknown. say:
    prints a line. now_s: a clock [s].
    """

    def __init__(
        self,
        what: str,
        total: int | None,
        say: Callable[[str], None],
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._what, self._total, self._say, self._now_s = what, total, say, now_s
        self._done = self._free = 0
        self._began_s = now_s()
        self._said_s = -EVERY_S

    def leave_out(self) -> None:
        """Count an item less: it need not be computed."""
        if self._total is not None:
            self._total -= 1

    def step(self, *, free: bool = False) -> None:
        """Count an item. free: it took no time, e.g. because it was computed earlier."""
        self._done += 1
        self._free += free
        now_s = self._now_s()
        last = self._done == self._total
        if not last and now_s - self._said_s < EVERY_S:
            return
        self._said_s = now_s
        worked = self._done - self._free
        if self._total is None:
            self._say(f"{self._what}: {self._done}")
            return
        left = ""
        if worked and not last:
            each_s = (now_s - self._began_s) / worked
            left = f", about {duration(each_s * (self._total - self._done))} left"
        self._say(f"{self._what}: {self._done} of {self._total}{left}")


def duration(seconds: float) -> str:
    """A duration for people: `40 s`, `12 min`, `3 h 20 min`."""
    if seconds < 99.5:
        return f"{max(seconds, 1):.0f} s"
    minutes = round(seconds / 60)
    if minutes < 100:
        return f"{minutes} min"
    return f"{minutes // 60} h {minutes % 60} min"
