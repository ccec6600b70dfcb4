"""Time as an argument: a clock to read and sleep on, and the keeper of a fixed rate."""

from __future__ import annotations

import time
from collections import deque
from typing import Protocol

from device.errors import DeviceError

NS_PER_S = 1_000_000_000


class Clock(Protocol):
    """Host-monotonic nanoseconds."""

    def now_ns(self) -> int:
        """The time now."""
        ...

    def sleep_until_ns(self, t_ns: int) -> None:
        """Returns once now_ns() >= t_ns; at once when that is already so."""
        ...


class SystemClock:
    """CLOCK_MONOTONIC, the clock the kernel stamps video buffers with."""

    def now_ns(self) -> int:
        return time.monotonic_ns()

    def sleep_until_ns(self, t_ns: int) -> None:
        while (left_ns := t_ns - time.monotonic_ns()) > 0:
            time.sleep(left_ns / NS_PER_S)


class ManualClock:
    """A clock that only moves when someone sleeps on it or advances it."""

    def __init__(self, now_ns: int = 0) -> None:
        self._now_ns = now_ns

    def now_ns(self) -> int:
        return self._now_ns

    def sleep_until_ns(self, t_ns: int) -> None:
        self._now_ns = max(self._now_ns, t_ns)

    def advance(self, duration_ns: int) -> None:
        """Time passes: duration_ns >= 0."""
        self._now_ns += duration_ns


class RateKeeper:
    """A loop at `hz` on absolute deadlines: lateness never accumulates, and a stall is not
    made up by a burst. Deadlines that passed during a stall are counted in `skipped`.
    """

    _WINDOW = 20
    _LATE_SHARE = 0.1

    def __init__(self, clock: Clock, hz: float) -> None:
        if not hz > 0:
            raise DeviceError(f"rate of {hz} Hz: must be above 0")
        self.period_ns = round(NS_PER_S / hz)
        self.skipped = 0
        self._clock = clock
        self._deadline_ns = clock.now_ns() + self.period_ns
        self._late: deque[bool] = deque(maxlen=self._WINDOW)

    @property
    def lagging(self) -> bool:
        """More than a tenth of the last 20 ticks did not fit into their period."""
        return sum(self._late) > self._LATE_SHARE * self._WINDOW

    def wait(self) -> int:
        """Sleeps to the next deadline; returns how many ns after it the caller wakes."""
        self._late.append(self._clock.now_ns() > self._deadline_ns)
        self._clock.sleep_until_ns(self._deadline_ns)
        lateness_ns = self._clock.now_ns() - self._deadline_ns
        missed = lateness_ns // self.period_ns
        self.skipped += missed
        self._deadline_ns += (missed + 1) * self.period_ns
        return lateness_ns
