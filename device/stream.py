"""State common to all camera drivers: counters, stamp order and the newest frame."""

from __future__ import annotations

import dataclasses
from collections import deque
from statistics import median
from typing import Literal

from device.camera import CameraStats
from device.frame import Frame

# assumed before the first step
_STEP_NS = 100_000_000
# frames whose delay between exposure and arrival is remembered
_DELAYS = 15

Count = Literal["reconnects", "host_stamped", "corrupt"]


class Stream:
    """Counters and newest frame of one camera; makes its stamps strictly increase.

    last_sequence: number of the newest frame or unusable buffer, None before the first.
    """

    def __init__(self) -> None:
        self.stats = CameraStats()
        self.newest: Frame | None = None
        self.last_sequence: int | None = None
        self._step_ns = _STEP_NS
        self._delays_ns: deque[int] = deque(maxlen=_DELAYS)

    def count(self, what: Count) -> None:
        """Increment a counter."""
        self.stats = dataclasses.replace(self.stats, **{what: getattr(self.stats, what) + 1})

    def lose(self, sequence: int) -> None:
        """Count a frame that arrived but cannot be used: as corrupt, not also as a drop."""
        self.count("corrupt")
        self._advance(sequence)

    def admit(self, frame: Frame, now_ns: int | None) -> Frame:
        """Count a frame; replace its stamp if it is after now_ns or not after the preceding one.

        Some drivers give stamps in the future (virtual cameras by 178 ms): these become now_ns. One
        that repeats or steps back is not the frame's own (`Frame.own_stamp`): it becomes the time
        of arrival less the usual delay, in a replay the preceding stamp plus the last step.
        `clamped` counts both. now_ns: current time on the clock of the stamps; None in a replay.
        """
        t_ns, own_stamp = frame.t_ns, frame.own_stamp
        if now_ns is not None:
            t_ns = min(t_ns, now_ns)
        if self.newest is not None and t_ns <= self.newest.t_ns:
            t_ns, own_stamp = self._next_ns(self.newest.t_ns, now_ns), False
        elif own_stamp:
            self._note(t_ns, now_ns)
        self._advance(frame.sequence)
        clamped = t_ns != frame.t_ns
        self.stats = dataclasses.replace(
            self.stats,
            frames=self.stats.frames + 1,
            clamped=self.stats.clamped + clamped,
        )
        if clamped:
            frame = dataclasses.replace(frame, t_ns=t_ns, own_stamp=own_stamp)
        self.newest = frame
        return frame

    def _note(self, t_ns: int, now_ns: int | None) -> None:
        """Note the step to a frame's own stamp, and the delay of its arrival."""
        if self.newest is not None:
            self._step_ns = t_ns - self.newest.t_ns
        if now_ns is not None:
            self._delays_ns.append(now_ns - t_ns)

    def _next_ns(self, newest_ns: int, now_ns: int | None) -> int:
        """Time of a frame without a usable stamp, after newest_ns and not after now_ns."""
        if now_ns is None:
            return newest_ns + self._step_ns
        usual = now_ns - round(median(self._delays_ns)) if self._delays_ns else now_ns
        # arrival itself is later than the preceding frame, unless the clock has not advanced
        return usual if usual > newest_ns else max(now_ns, newest_ns + 1)

    def _advance(self, sequence: int) -> None:
        """Go on to the next sequence number; the numbers left out are drops."""
        if self.last_sequence is not None:
            drops = max(0, sequence - self.last_sequence - 1)
            self.stats = dataclasses.replace(self.stats, drops=self.stats.drops + drops)
        self.last_sequence = sequence
