"""What the writer says of itself, and the id of this boot."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from calm_edge.recording.space import Space

_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")


@dataclass(frozen=True, slots=True)
class WriterHealth:
    """How the recording is doing. error: empty while it is being written.

    written: messages kept so far. dropped_*: lost to a full mailbox. unwritable: items that
    could not be encoded. queue_fill: 0 ... 1 of the mailbox. sync_ms: the last flush to disk.
    space: the disk as it was then.
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
    """The kernel's id of this boot, empty where there is none."""
    try:
        return _BOOT_ID.read_text().strip()
    except OSError:
        return ""
