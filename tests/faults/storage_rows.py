"""Fault rows in which the disk fills up, fails or turns read-only during recording."""

from __future__ import annotations

import errno
import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from calm_edge.config import merge
from calm_edge.daemon.hub import Hub
from calm_edge.recording import writer
from calm_edge.recording.recovery import Outcome, validate
from tests.faults.row import AfterFrames, Row, all_frames, states
from tests.replay.daemon_run import config_for, record


@contextmanager
def small_disk(folder: Path, size: str) -> Iterator[Path | None]:
    """Context with a small mounted file system; None if none can be mounted."""
    folder.mkdir(parents=True)
    mount = shutil.which("mount")
    command = [mount or "mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder)]
    if mount is None or subprocess.run(command, capture_output=True).returncode:
        yield None
        return
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


@contextmanager
def quick_retry() -> Iterator[None]:
    """Context in which the writer retries a failed disk ten times a second."""
    before, writer.RETRY_S = writer.RETRY_S, 0.1
    try:
        yield
    finally:
        writer.RETRY_S = before


class Poses:
    """Counts the poses between two marks."""

    def __init__(self) -> None:
        self._at: list[int] = []

    def mark(self, hub: Hub) -> None:
        self._at.append(hub.result.poses + hub.result.lost_poses)

    @property
    def meanwhile(self) -> int:
        return self._at[-1] - self._at[0]


def full_disk(drive: Path, n: int, folder: Path) -> Row:
    """Fill a small file system during recording, then free it."""
    fault, promise = "disk full", "recording stops and resumes, poses continue, no frame lost"
    with small_disk(folder / "disk", "64m") as disk, quick_retry():
        if disk is None:
            return Row(fault, "no tmpfs can be mounted here", promise, False, skipped=True)
        ballast, poses = disk / "ballast", Poses()
        wrong: list[str] = []

        def fill(hub: Hub) -> None:
            room = os.statvfs(disk)
            ballast.write_bytes(b"\0" * (room.f_bavail * room.f_frsize - (9 << 20)))
            poses.mark(hub)

        def free(hub: Hub) -> None:
            wrong.append(hub.recording.health.error)
            poses.mark(hub)
            ballast.unlink()

        changes = {"recording": {"keep_free_gib": 0.0, "keep_free_percent": 0.0, "flush_s": 0.2}}
        config = merge(config_for(drive), changes)
        during = AfterFrames((n // 4, fill), (3 * n // 4, free))
        result, _ = record(drive, disk / "rec", lockstep=False, config=config, during=during)
        found, whole = states(disk / "rec"), validate(disk / "rec").outcome is Outcome.ALL
        segments = len(list((disk / "rec").glob("*.mcap")))
        complete = all_frames(disk / "rec", n)
    return Row(
        fault,
        f"{segments} segments, all whole, {poses.meanwhile} poses meanwhile, "
        f"{2 * n} of {sum(result.frames)} frames; {' '.join(found)}",
        promise,
        "No space left" in wrong[0]
        and segments > 1
        and whole
        and complete
        and result.unrecorded == 0
        and poses.meanwhile > 0,
    )


class FailingDisk:
    """A disk whose writes fail between `fail` and `repair`."""

    def __init__(self, code: int) -> None:
        self._code, self._fails = code, False

    def fail(self, _: Hub) -> None:
        self._fails = True

    def repair(self, _: Hub) -> None:
        self._fails = False

    def __call__(self, fd: int, data: bytes) -> int:
        if self._fails:
            raise OSError(self._code, os.strerror(self._code))
        return os.write(fd, data)


def failing_disk(drive: Path, n: int, folder: Path, code: int = errno.EIO) -> Row:
    """Let every write fail for half of the drive."""
    disk, poses = FailingDisk(code), Poses()
    wrong: list[str] = []

    def repair(hub: Hub) -> None:
        wrong.append(hub.recording.health.error)
        poses.mark(hub)
        disk.repair(hub)

    during = AfterFrames((n // 4, disk.fail), (n // 4 + 1, poses.mark), (3 * n // 4, repair))
    config = merge(config_for(drive), {"recording": {"flush_s": 0.2}})
    with quick_retry():
        result, _ = record(
            drive, folder / "rec", lockstep=False, config=config, during=during, write=disk
        )
    segments = len(list((folder / "rec").glob("*.mcap*")))
    return Row(
        f"write error ({os.strerror(code)})",
        f"{poses.meanwhile} poses meanwhile, {2 * n} of {sum(result.frames)} frames in "
        f"{segments} segments; {' '.join(states(folder / 'rec'))}",
        "recording resumes in a new segment, poses continue, no frame lost",
        os.strerror(code) in wrong[0]
        and all_frames(folder / "rec", n)
        and result.unrecorded == 0
        and poses.meanwhile > 0,
    )


def read_only_disk(drive: Path, n: int, folder: Path) -> Row:
    """Let the file system turn read-only, as ext4 does after an error."""
    return failing_disk(drive, n, folder, errno.EROFS)
