"""State common to all camera drivers: counters, stamp order and the newest frame."""

from __future__ import annotations

import dataclasses
from typing import Literal

from device.camera import CameraStats
from device.frame import Frame

Count = Literal["reconnects", "host_stamped", "corrupt"]


class Stream:
    """Counters and newest frame of one camera; makes its stamps strictly increase.

    last_sequence: number of the newest frame or unusable buffer, None before the first.
    """

    def __init__(self) -> None:
        self.stats = CameraStats()
        self.newest: Frame | None = None
        self.last_sequence: int | None = None

    def count(self, what: Count) -> None:
        """Increment a counter."""
        self.stats = dataclasses.replace(self.stats, **{what: getattr(self.stats, what) + 1})

    def lose(self, sequence: int) -> None:
        """Count a frame that arrived but cannot be used: as corrupt, not also as a drop."""
        self.count("corrupt")
        self._advance(sequence)

    def admit(self, frame: Frame, now_ns: int | None) -> Frame:
        """Count a frame and clamp its stamp to lie after the preceding one and not after now_ns.

        Some drivers give stamps in the future (virtual cameras by 178 ms); `clamped` counts the
        corrected ones. now_ns: current time on the clock of the stamps; None in a replay.
        """
        t_ns = frame.t_ns if now_ns is None else min(frame.t_ns, now_ns)
        if self.newest is not None:
            t_ns = max(t_ns, self.newest.t_ns + 1)
        self._advance(frame.sequence)
        clamped = t_ns != frame.t_ns
        self.stats = dataclasses.replace(
            self.stats,
            frames=self.stats.frames + 1,
            clamped=self.stats.clamped + clamped,
        )
        self.newest = dataclasses.replace(frame, t_ns=t_ns) if clamped else frame
        return self.newest

    def _advance(self, sequence: int) -> None:
        """Go on to the next sequence number; the numbers left out are drops."""
        if self.last_sequence is not None:
            drops = max(0, sequence - self.last_sequence - 1)
            self.stats = dataclasses.replace(self.stats, drops=self.stats.drops + drops)
        self.last_sequence = sequence
