"""Drives under one root: their names, the flag that keeps one, and which file goes first.

Names count up and do not carry a date: a car's computer may have no clock that survives the night.
"""

from __future__ import annotations

import os
import re
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from calm_edge.recording.errors import RecordingError
from calm_edge.recording.health import boot_id
from calm_edge.recording.segment import segment_files

# in the folder of a drive that must not be removed
KEEP_FLAG = "KEEP"
# what `record` leaves beside the segments, and what therefore goes with the last of them
TRAJECTORY_FILE = "record_trajectory.tum"
_NAME = re.compile(r"(\d{6,})-[0-9a-z]+")


class Removed(NamedTuple):
    """A segment that is gone, and how many bytes it had."""

    path: Path
    size: int


def drives(root: Path) -> list[Path]:
    """The folders under `root` that `new_drive` made, oldest first; empty where there is none."""
    try:
        found = [(m, p) for p in root.iterdir() if (m := _NAME.fullmatch(p.name)) and p.is_dir()]
    except OSError:
        return []
    return [p for _, p in sorted(found, key=lambda f: (int(f[0][1]), f[1].name))]


def new_drive(root: Path) -> Path:
    """Makes `COUNTER-BOOT` under `root`, the counter one above all there are.

    Raises RecordingError when it cannot be made.
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
    """Whether the drive must not be removed; so too where that cannot be told."""
    try:
        (drive / KEEP_FLAG).lstat()
    except FileNotFoundError:
        return False
    except OSError:
        return True
    return True


def set_kept(drive: Path, kept: bool) -> None:
    """Sets or takes away the flag, on the disk when this returns; raises RecordingError."""
    if not drive.is_dir() or not segment_files(drive):
        raise RecordingError(f"{drive}: holds no recording (no NNNN.mcap in it)")
    try:
        if kept:
            (drive / KEEP_FLAG).touch()
        else:
            (drive / KEEP_FLAG).unlink(missing_ok=True)
        fd = os.open(drive, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(fd)
        finally:
            os.close(fd)
    except OSError as error:
        raise RecordingError(f"{drive}: cannot be written ({error.strerror})") from None


def remove_oldest(root: Path, present: Path) -> Removed | None:
    """Removes the oldest segment of the oldest drive not kept; None when nothing may go.

    The drive `present` is the last one in turn, and its newest segment, which is being written,
    never goes.
    """
    for drive in [*(d for d in drives(root) if d != present), present]:
        if is_kept(drive):
            continue
        try:
            segments = segment_files(drive)
            if drive == present:
                segments = segments[:-1]
            elif len(segments) <= 1:
                (drive / TRAJECTORY_FILE).unlink(missing_ok=True)
            size = segments[0].stat().st_size if segments else 0
            if segments:
                segments[0].unlink()
            if drive != present and len(segments) <= 1:
                # not when it holds something of somebody else's
                with suppress(OSError):
                    drive.rmdir()
        except (OSError, RecordingError):
            # a drive that cannot be removed must not hold up the others
            continue
        if segments:
            return Removed(segments[0], size)
    return None
