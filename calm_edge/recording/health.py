"""State of the recording's writer and of its disk; the kernel's boot id."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")


@dataclass(frozen=True, slots=True)
class Space:
    """Free space of the disk.

    free_bytes: available to an unprivileged user, None if unknown. floor_bytes: minimum to be left
    free. bytes_per_s: current rate of recording. removes_old: old drives are removed when the
    minimum is reached.
    """

    free_bytes: int | None = None
    floor_bytes: int = 0
    bytes_per_s: float = 0.0
    removes_old: bool = False

    @property
    def left_s(self) -> float | None:
        """Seconds until free_bytes falls to floor_bytes at the current rate; None if unknown."""
        if self.free_bytes is None or self.bytes_per_s <= 0:
            return None
        return max(0.0, (self.free_bytes - self.floor_bytes) / self.bytes_per_s)


@dataclass(frozen=True, slots=True)
class WriterHealth:
    """State of the writer. error: empty while recording works.

    dropped_*: items lost because the queue was full. unwritable: items that could not be encoded or
    stored. queue_fill: 0 ... 1. sync_ms: duration of the last sync to disk. space: free space when
    last checked. kept: the drive is protected from removal.
    """

    error: str
    dropped_images: int
    dropped_others: int
    unwritable: int
    queue_fill: float
    sync_ms: float
    space: Space = field(default_factory=Space)
    kept: bool = False


def boot_id() -> str:
    """Return the kernel's id of this boot, or an empty text."""
    try:
        return _BOOT_ID.read_text().strip()
    except OSError:
        return ""
