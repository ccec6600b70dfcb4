"""State of the recording's writer, and the kernel's boot id."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from calm_edge.recording.space import Space

_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")


@dataclass(frozen=True, slots=True)
class WriterHealth:
    """State of the writer. error: empty while recording works.

    written: messages in files. dropped_*: items lost to a full queue. unwritable: items that
    could not be encoded or stored. queue_fill: 0 ... 1. sync_ms: duration of the last sync to
    disk. space: the disk when last checked.
    """

    error: str
    written: int
    dropped_images: int
    dropped_others: int
    unwritable: int
    queue_fill: float
    sync_ms: float
    space: Space = field(default_factory=Space)

    @property
    def ok(self) -> bool:
        return not self.error


def boot_id() -> str:
    """Return the kernel's id of this boot, or an empty text."""
    try:
        return _BOOT_ID.read_text().strip()
    except OSError:
        return ""
