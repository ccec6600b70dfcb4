"""State common to all camera drivers: counters, stamp order and the newest frame."""

from __future__ import annotations

import dataclasses
from typing import Literal

from device.camera import CameraStats
from device.frame import Frame

Count = Literal["reconnects", "host_stamped", "corrupt"]


class Stream:
    """Counters and newest frame of one camera; makes its stamps strictly increase."""

    def __init__(self) -> None:
        self.stats = CameraStats()
        self.newest: Frame | None = None

    def count(self, what: Count) -> None:
        """Increment a counter."""
        self.stats = dataclasses.replace(self.stats, **{what: getattr(self.stats, what) + 1})

    def admit(self, frame: Frame, now_ns: int | None) -> Frame:
        """Count a frame and clamp its stamp to lie after the preceding one and not after now_ns.

        Some drivers give stamps in the future (virtual cameras by 178 ms); `clamped` counts the
        corrected ones. now_ns: current time on the clock of the stamps; None in a replay.
        """
        t_ns = frame.t_ns if now_ns is None else min(frame.t_ns, now_ns)
        drops = 0
        if self.newest is not None:
            t_ns = max(t_ns, self.newest.t_ns + 1)
            drops = max(0, frame.sequence - self.newest.sequence - 1)
        clamped = t_ns != frame.t_ns
        self.stats = dataclasses.replace(
            self.stats,
            frames=self.stats.frames + 1,
            drops=self.stats.drops + drops,
            clamped=self.stats.clamped + clamped,
        )
        self.newest = dataclasses.replace(frame, t_ns=t_ns) if clamped else frame
        return self.newest
