"""Watch the free disk space, remove old drives when it runs low, and estimate the time left."""

from __future__ import annotations

import os
from collections import deque
from pathlib import Path

from calm_edge.config import ConfigError, RecordingConfig
from calm_edge.recording import RecordingError
from calm_edge.recording.health import Space
from calm_edge.recording.retention import remove_oldest

# smallest floor (bytes to be left free): space for a segment's summary and for the system
RESERVE_BYTES = 8 << 20
# recording resumes with this much free above the floor; with less it would soon stop again
HEADROOM_BYTES = 2 * RESERVE_BYTES
_RATE_SAMPLES = 60


class Room:
    """Monitor of the disk that holds a recording, used by the writer thread.

    root: folder of all drives, the oldest of which are removed when free space falls to the
    configured minimum; None removes nothing. space: the last measurement.
    """

    def __init__(self, folder: Path, config: RecordingConfig, root: Path | None = None) -> None:
        self._folder, self._config = folder, config
        self._root = root if config.remove_old else None
        self._history: deque[tuple[float, int]] = deque(maxlen=_RATE_SAMPLES)
        self.space = Space(removes_old=self._root is not None)
        self._removed: list[Path] = []

    def check(self, now_s: float, written_bytes: int) -> bool:
        """Measure the free space and make room if allowed; False if recording has to stop.

        written_bytes: recorded so far. If the free space cannot be measured, nothing is removed.
        """
        self._history.append((now_s, written_bytes))
        elapsed_s = now_s - self._history[0][0]
        rate = (written_bytes - self._history[0][1]) / elapsed_s if elapsed_s > 0 else 0.0
        free, floor = self._make_room()
        self.space = Space(free, floor, rate, self._root is not None)
        return free is None or free >= floor

    def can_resume(self) -> bool:
        """True if there is enough free space to begin a segment after recording had to stop."""
        free, floor = self._make_room()
        return free is not None and free >= floor + HEADROOM_BYTES

    def take_removed(self) -> list[Path]:
        """Return the segments removed since the last call."""
        removed, self._removed = self._removed, []
        return removed

    def _make_room(self) -> tuple[int | None, int]:
        free, floor = measure(self._folder, self._config)
        if self._root is None or free is None:
            return free, floor
        missing = floor + HEADROOM_BYTES - free
        while missing > 0 and (gone := remove_oldest(self._root, self._folder)) is not None:
            self._removed.append(gone.path)
            free, floor = measure(self._folder, self._config)
            # some file systems free the space later: count the removed bytes as free already
            missing = min(missing - gone.size, floor + HEADROOM_BYTES - (free or 0))
        return free, floor


def measure(folder: Path, config: RecordingConfig) -> tuple[int | None, int]:
    """Return (free bytes, or None if unknown; minimum of bytes to be left free)."""
    try:
        disk = os.statvfs(folder)
    except OSError:
        return None, RESERVE_BYTES
    percent = disk.f_blocks * disk.f_frsize * config.keep_free_percent / 100
    floor = max(int(config.keep_free_gib * (1 << 30)), int(percent), RESERVE_BYTES)
    return disk.f_bavail * disk.f_frsize, floor


def check_settings(config: RecordingConfig) -> None:
    """Check the section [recording]; raises ConfigError for a value out of range."""
    for key in ("segment_s", "chunk_bytes", "flush_s"):
        if not getattr(config, key) > 0:
            raise ConfigError(f"recording.{key} = {getattr(config, key):g}: must be above 0")
    if not 1 <= config.jpeg_quality <= 100:
        raise ConfigError(f"recording.jpeg_quality = {config.jpeg_quality}: must be 1 to 100")
    if config.keep_free_gib < 0 or not 0 <= config.keep_free_percent < 100:
        raise ConfigError(
            f"recording.keep_free_gib = {config.keep_free_gib:g}, keep_free_percent = "
            f"{config.keep_free_percent:g}: must not be negative, percent below 100"
        )


def check_room(folder: Path, config: RecordingConfig, root: Path | None = None) -> None:
    """Check the free disk space before recording into `folder`, which need not exist.

    Raises RecordingError if there is too little, ConfigError for invalid settings.
    """
    check_settings(config)
    above = next(p for p in (folder, *folder.absolute().parents) if p.exists())
    room = Room(above, config, root)
    if room.check(0.0, 0):
        return
    free, floor = room.space.free_bytes or 0, room.space.floor_bytes
    kept = ", or release a kept drive (calm-edge keep --release)" if root is not None else ""
    raise RecordingError(
        f"{above}: {free / (1 << 30):.2f} GiB free, and {floor / (1 << 30):.2f} GiB have to stay "
        f"free (recording.keep_free_gib, keep_free_percent); delete files{kept}"
    )
