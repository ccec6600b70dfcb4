"""Name the drive folders under a root, mark drives to keep, and remove the oldest segments.

Folder names contain a counter and no date: a car's computer may have no clock that runs while it is
off.
"""

from __future__ import annotations

import re
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from calm_edge.recording import RecordingError
from calm_edge.recording.health import boot_id
from calm_edge.recording.segment import segment_files
from device.atomic_file import sync_folder

# file that marks a drive which must not be removed
KEEP_FLAG = "KEEP"
# written by `record` and `report` beside the segments, and removed with the last of them
TRAJECTORY_FILE, REPORT_FILE = "record_trajectory.tum", "report.html"
_NAME = re.compile(r"(\d{6,})-[0-9a-z]+")


class Removed(NamedTuple):
    """A removed segment and its size in bytes."""

    path: Path
    size: int


def drives(root: Path) -> list[Path]:
    """List the drive folders created by `new_drive` under `root`, oldest first."""
    try:
        found = [(m, p) for p in root.iterdir() if (m := _NAME.fullmatch(p.name)) and p.is_dir()]
    except OSError:
        return []
    return [p for _, p in sorted(found, key=lambda f: (int(f[0][1]), f[1].name))]


def new_drive(root: Path) -> Path:
    """Create the folder `COUNTER-BOOTID` under `root`, with the next counter.

    Raises RecordingError if it cannot be created.
    """
    boot = boot_id().replace("-", "")[:8] or "0"
    try:
        root.mkdir(parents=True, exist_ok=True)
        while True:
            newest = [int(p.name.partition("-")[0]) for p in drives(root)[-1:]]
            path = root / f"{max(newest, default=0) + 1:06d}-{boot}"
            with suppress(FileExistsError):
                path.mkdir()
                return path
    except OSError as error:
        raise RecordingError(
            f"{root}: cannot be written ({error.strerror}); name another root"
        ) from None


def is_kept(drive: Path) -> bool:
    """True if a drive is marked to be kept, or if that cannot be determined."""
    try:
        (drive / KEEP_FLAG).lstat()
    except FileNotFoundError:
        return False
    except OSError:
        return True
    return True


def set_kept(drive: Path, kept: bool) -> None:
    """Mark a drive to be kept, or remove the mark, synced to disk; raises RecordingError."""
    if not drive.is_dir() or not segment_files(drive):
        raise RecordingError(f"{drive}: holds no recording (NNNN.mcap); name another folder")
    try:
        if kept:
            (drive / KEEP_FLAG).touch()
        else:
            (drive / KEEP_FLAG).unlink(missing_ok=True)
        sync_folder(drive)
    except OSError as error:
        raise RecordingError(f"{drive}: cannot be written ({error.strerror})") from None


def remove_oldest(root: Path, present: Path) -> Removed | None:
    """Remove the oldest segment of the oldest drive not kept; None if there is none to remove.

    present: the drive being recorded; its segments are removed last, and its newest one never.
    """
    for drive in [*(d for d in drives(root) if d != present), present]:
        if is_kept(drive):
            continue
        try:
            segments = segment_files(drive)
            if drive == present:
                segments = segments[:-1]
            elif len(segments) <= 1:
                for name in (TRAJECTORY_FILE, REPORT_FILE):
                    (drive / name).unlink(missing_ok=True)
            size = segments[0].stat().st_size if segments else 0
            if segments:
                segments[0].unlink()
            if drive != present and len(segments) <= 1:
                # rmdir fails if the folder contains other files, which must stay
                with suppress(OSError):
                    drive.rmdir()
        except (OSError, RecordingError):
            # a drive that cannot be removed must not prevent the removal of others
            continue
        if segments:
            return Removed(segments[0], size)
    return None
