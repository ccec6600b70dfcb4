"""Free space on the disk that holds a recording."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Space:
    """A measurement of the disk.

    free_bytes: available to an unprivileged user, None if unknown. floor_bytes: have to stay
    free. bytes_per_s: current rate of recording. removes_old: old drives are removed at the floor.
    """

    free_bytes: int | None = None
    floor_bytes: int = 0
    bytes_per_s: float = 0.0
    removes_old: bool = False

    @property
    def left_s(self) -> float | None:
        """Seconds until the floor is reached at the current rate; None if unknown."""
        if self.free_bytes is None or self.bytes_per_s <= 0:
            return None
        return max(0.0, (self.free_bytes - self.floor_bytes) / self.bytes_per_s)
