"""Fault rows in which disk, estimator, tracker, serial line or page stop responding."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from unittest.mock import patch

from calm_edge.config import PoseOutputConfig, merge
from calm_edge.daemon.estimator_link import INBOX_WINDOWS
from calm_edge.daemon.hub import Hub
from calm_edge.daemon.live_output import LiveOutput
from calm_edge.daemon.outputs import MavlinkOutput
from calm_edge.live import link
from calm_edge.pose_output.publisher import PosePublisher
from calm_edge.recording.reader import Recording
from device.frame import Eye
from device.serial_port import SerialPort
from tests.faults.row import AfterFrames, Row, all_frames, health, loop_figures, sequences
from tests.faults.slow_estimator import FIRST_S, LATER_S, slow_estimator
from tests.replay.daemon_run import config_for, record


class BlockingDisk:
    """A disk whose writes block between `block` and `go`."""

    def __init__(self) -> None:
        self._go = threading.Event()
        self._go.set()
        self.blocked_s = 0.0

    def block(self, _: Hub) -> None:
        self._go.clear()

    def go(self, _: object = None) -> None:
        self._go.set()

    def __call__(self, fd: int, data: bytes) -> int:
        started = time.monotonic()
        assert self._go.wait(120)
        self.blocked_s += time.monotonic() - started
        return os.write(fd, data)


def blocking_disk(drive: Path, n: int, folder: Path) -> Row:
    """The disk blocks for half of the drive, and the queue is large enough."""
    disk = BlockingDisk()
    during = AfterFrames((n // 4, disk.block), (3 * n // 4, disk.go))
    result, _ = record(drive, folder / "rec", lockstep=False, during=during, write=disk)
    kept = result.frames == [n, n] and result.unrecorded == 0 and all_frames(folder / "rec", n)
    return Row(
        "disk blocks",
        f"{disk.blocked_s:.1f} s, {2 * n} of {sum(result.frames)} frames recorded, "
        f"{loop_figures(folder / 'rec')}",
        "no frame lost",
        kept and disk.blocked_s > 0.2 * n / 10,
    )


def blocking_disk_full_queue(drive: Path, n: int, folder: Path) -> Row:
    """The disk blocks until the end, and the queue is too small."""
    disk = BlockingDisk()
    queue_bytes = 100_000
    hubs: list[Hub] = []
    fills: list[float] = []

    def watch(hub: Hub) -> None:
        hubs.append(hub)
        fills.append(hub.recording.health.queue_fill)

    during = AfterFrames((n // 4, disk.block), *((k, watch) for k in range(n // 4 + 1, n)))
    threading.Timer(n / 10 + 4, disk.go).start()
    result, _ = record(
        drive, folder / "rec", lockstep=False, during=during, write=disk, queue_bytes=queue_bytes
    )
    recording = Recording(folder / "rec")
    lost = 2 * n - sum(len(sequences(recording, eye)) for eye in Eye)
    counted = hubs[0].recording.health.dropped_images
    return Row(
        "disk blocks, queue full",
        f"queue {max(fills):.0%} of its {queue_bytes // 1000} kB, {lost} images lost, "
        f"{counted} counted",
        "memory bounded; all frames captured; each loss counted",
        result.frames == [n, n] and 0 < lost == counted and max(fills) <= 1.0,
    )


def suspended_estimator(drive: Path, n: int, folder: Path) -> Row:
    """The estimator is suspended during its first window and resumed after the last frame."""
    waiting: list[int] = []

    def stop(hub: Hub) -> None:
        os.kill(hub.estimator.child.pid, signal.SIGSTOP)

    def go(hub: Hub) -> None:
        waiting.append(hub.estimator.waiting)
        os.kill(hub.estimator.child.pid, signal.SIGCONT)

    during = AfterFrames((5, stop), (n - 1, go))
    result, _ = record(drive, folder / "rec", lockstep=False, during=during)
    kept = result.frames == [n, n] and result.unrecorded == 0 and all_frames(folder / "rec", n)
    return Row(
        "estimator suspended",
        f"{waiting[0]} windows waited, {result.submaps} of {result.windows} solved in the end, "
        f"{loop_figures(folder / 'rec')}",
        f"no frame lost, at most {INBOX_WINDOWS + 1} windows wait",
        kept and 0 < waiting[0] <= INBOX_WINDOWS + 1,
    )


def slow_from_the_start(drive: Path, n: int, folder: Path) -> Row:
    """The first sub-map is too late for the tracker, and windows are slower than they arrive."""
    first: list[float] = []

    def watch(hub: Hub, _: str) -> None:
        if hub.result.poses and not first:
            first.append(hub.result.frames[0] / 10)

    with slow_estimator():
        result, _ = record(drive, folder / "rec", lockstep=False, during=watch)
    # the window being solved when the first is done, and the one after it
    limit_s = FIRST_S + 2 * LATER_S + 2
    kept = result.frames == [n, n] and result.unrecorded == 0 and all_frames(folder / "rec", n)
    when = f"first pose after {first[0]:.1f} s" if first else "no pose"
    return Row(
        f"estimator slow from the start: {FIRST_S:.0f} s, then {LATER_S:.0f} s per window",
        f"{when}, {result.poses} poses, {len(result.windows_left_to_map)} of {result.windows} "
        "windows left for calm-edge map",
        f"no frame lost; a pose within {limit_s:.0f} s",
        kept and bool(first) and first[0] <= limit_s,
    )


def suspended_tracker(drive: Path, n: int, folder: Path) -> Row:
    """The tracker is suspended for half of the drive: its ring fills, frames are still recorded."""

    def stop(hub: Hub) -> None:
        os.kill(hub.tracker.child.pid, signal.SIGSTOP)

    def go(hub: Hub) -> None:
        os.kill(hub.tracker.child.pid, signal.SIGCONT)

    during = AfterFrames((n // 4, stop), (3 * n // 4, go))
    result, _ = record(drive, folder / "rec", lockstep=False, during=during)
    kept = result.frames == [n, n] and result.unrecorded == 0 and all_frames(folder / "rec", n)
    return Row(
        "tracker suspended",
        f"{result.untracked} frames recorded but not tracked, {loop_figures(folder / 'rec')}",
        "no frame lost; untracked frames are counted",
        kept and 0 < result.untracked < 2 * n,
    )


def stalled_serial(drive: Path, n: int, folder: Path) -> Row:
    """The far end of the serial line does not read, and all buffers are full."""
    far, near = os.openpty()
    config = config_for(drive)
    port = SerialPort(os.ttyname(near), 115_200)
    publisher = PosePublisher(port, PoseOutputConfig(port=port.path), spacing_known=True)
    line = MavlinkOutput(port, publisher, time.monotonic_ns)
    # fill the kernel's buffer, which holds some seconds of poses
    for _ in range(400):
        port.write(b"x" * 250)
        time.sleep(0.0005)
    try:
        result, _ = record(
            drive,
            folder / "rec",
            lockstep=False,
            config=config,
            outputs=[line],
        )
        dropped = port.stats().dropped
    finally:
        port.stop()
        os.close(near)
        os.close(far)
    kept = result.frames == [n, n] and result.unrecorded == 0 and all_frames(folder / "rec", n)
    reported = health(folder / "rec")[-1]["drops"]["serial_messages"]
    return Row(
        "serial receiver stalled",
        f"{dropped} messages dropped, {result.poses} poses recorded, "
        f"{loop_figures(folder / 'rec')}",
        "no frame lost; messages not sent are counted",
        kept and 0 < reported <= dropped == result.output_losses["serial"] and result.poses > 0,
    )


def suspended_live_page(drive: Path, n: int, folder: Path) -> Row:
    """The live page's process is suspended while pictures are sent to it, then killed."""
    socket = folder / "live.sock"
    config = merge(config_for(drive), {"live": {"socket": str(socket)}})
    command = [sys.executable, "-m", "calm_edge.cli", "live", "--socket", str(socket)]
    # with little room in between, and no patience
    with (
        patch.object(link, "BUFFER_BYTES", 4096),
        patch.object(link, "STALL_S", 0.5),
        subprocess.Popen(
            [*command, "--address", "127.0.0.1:0"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        ) as page,
    ):
        output = LiveOutput(config, time.monotonic_ns)
        connected_s = time.monotonic() + 60
        while not output.readers and time.monotonic() < connected_s:
            time.sleep(0.05)
        readers = output.readers

        def suspend(_: Hub) -> None:
            page.send_signal(signal.SIGSTOP)

        def kill(_: Hub) -> None:
            page.kill()

        during = AfterFrames((n // 4, suspend), (3 * n // 4, kill))
        try:
            result, _ = record(
                drive,
                folder / "rec",
                lockstep=False,
                config=config,
                during=during,
                outputs=[output],
            )
        finally:
            page.kill()
    kept = result.frames == [n, n] and result.unrecorded == 0 and all_frames(folder / "rec", n)
    return Row(
        "live page suspended, then killed",
        f"{sum(result.frames)} of {2 * n} frames recorded, {result.poses} poses, page dropped "
        f"{output.dropped_readers} times, {loop_figures(folder / 'rec')}",
        "no frame lost; the page is dropped, not waited for",
        kept
        and readers == 1
        and output.dropped_readers > 0
        and result.output_losses["live"] == 0
        and not result.output_faults,
    )
