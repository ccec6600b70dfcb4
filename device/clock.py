"""Clocks that can be read and slept on, and a fixed-rate loop timer."""

from __future__ import annotations

import time
from collections import deque
from typing import Protocol

from device.errors import DeviceError

NS_PER_S = 1_000_000_000


class Clock(Protocol):
    """A clock in host-monotonic nanoseconds, passed as an argument so that tests can replace it."""

    def now_ns(self) -> int:
        """Return the current time."""
        ...

    def sleep_until_ns(self, t_ns: int) -> None:
        """Sleep until now_ns() >= t_ns; return at once if that holds already."""
        ...


class SystemClock:
    """CLOCK_MONOTONIC, the clock with which the kernel stamps video buffers."""

    def now_ns(self) -> int:
        return time.monotonic_ns()

    def sleep_until_ns(self, t_ns: int) -> None:
        while (left_ns := t_ns - time.monotonic_ns()) > 0:
            time.sleep(left_ns / NS_PER_S)


class RateKeeper:
    """Time a loop at `hz` by absolute deadlines, so that delays do not accumulate.

    Deadlines that pass during a stall are skipped and counted in `skipped`, not run in a burst.
    """

    _WINDOW = 20
    _LATE_SHARE = 0.1

    def __init__(self, clock: Clock, hz: float) -> None:
        if not hz > 0:
            raise DeviceError(f"loop rate {hz} Hz: must be above 0")
        self.period_ns = round(NS_PER_S / hz)
        self.skipped = 0
        self._clock = clock
        self._deadline_ns = clock.now_ns() + self.period_ns
        self._late: deque[bool] = deque(maxlen=self._WINDOW)

    @property
    def lagging(self) -> bool:
        """True if the loop body overran its period in more than 2 of the last 20 ticks."""
        return sum(self._late) > self._LATE_SHARE * self._WINDOW

    def wait(self) -> int:
        """Sleep until the next deadline; return how late it was on waking, in ns."""
        self._late.append(self._clock.now_ns() > self._deadline_ns)
        self._clock.sleep_until_ns(self._deadline_ns)
        lateness_ns = self._clock.now_ns() - self._deadline_ns
        missed = lateness_ns // self.period_ns
        self.skipped += missed
        self._deadline_ns += (missed + 1) * self.period_ns
        return lateness_ns
