"""The disk under a recording as it was looked at last."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Space:
    """free_bytes: for an ordinary user, None where the disk does not say. floor_bytes: stay free.

    bytes_per_s: the present rate of recording. removes_old: old drives make room at the floor.
    """

    free_bytes: int | None = None
    floor_bytes: int = 0
    bytes_per_s: float = 0.0
    removes_old: bool = False

    @property
    def left_s(self) -> float | None:
        """Seconds to the floor at the present rate; None while that is not known."""
        if self.free_bytes is None or self.bytes_per_s <= 0:
            return None
        return max(0.0, (self.free_bytes - self.floor_bytes) / self.bytes_per_s)
