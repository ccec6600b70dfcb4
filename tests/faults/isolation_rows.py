"""Capture is slowed by nothing behind it: disk, estimator, tracker, serial line."""

from __future__ import annotations

import os
import signal
import threading
import time
from pathlib import Path

from calm_edge.config import PoseOutputConfig
from calm_edge.daemon.estimator_link import INBOX_WINDOWS
from calm_edge.daemon.hub import Hub
from calm_edge.daemon.outputs import SerialOutput
from calm_edge.pose_output.publisher import PosePublisher
from calm_edge.recording.reader import Recording
from device.frame import Eye
from device.serial_port import SerialPort
from tests.faults.row import AfterFrames, Row, all_frames, health, loop_figures, sequences
from tests.faults.slow_estimator import FIRST_S, LATER_S, slow_estimator
from tests.replay.daemon_run import config_for, record


class StandingDisk:
    """Stands still while told to: whoever writes to it waits."""

    def __init__(self) -> None:
        self._go = threading.Event()
        self._go.set()
        self.stood_s = 0.0

    def stand(self, _: Hub) -> None:
        self._go.clear()

    def go(self, _: object = None) -> None:
        self._go.set()

    def __call__(self, fd: int, data: bytes) -> int:
        started = time.monotonic()
        assert self._go.wait(120)
        self.stood_s += time.monotonic() - started
        return os.write(fd, data)


def standing_disk(drive: Path, n: int, folder: Path) -> Row:
    """The disk stands for half of the drive, and the queue has room for it."""
    disk = StandingDisk()
    during = AfterFrames((n // 4, disk.stand), (3 * n // 4, disk.go))
    result, _ = record(drive, folder / "rec", lockstep=False, during=during, write=disk)
    kept = result.frames == [n, n] and result.unrecorded == 0 and all_frames(folder / "rec", n)
    return Row(
        "disk stands still",
        f"{disk.stood_s:.1f} s, {2 * n} of {sum(result.frames)} frames recorded, "
        f"{loop_figures(folder / 'rec')}",
        "no frame lost",
        kept and disk.stood_s > 0.2 * n / 10,
    )


def endless_disk(drive: Path, n: int, folder: Path) -> Row:
    """The disk stands until the end, and the queue is too small for it."""
    disk = StandingDisk()
    queue_bytes = 100_000
    hubs: list[Hub] = []
    fills: list[float] = []

    def watch(hub: Hub) -> None:
        hubs.append(hub)
        fills.append(hub.recording.health.queue_fill)

    during = AfterFrames((n // 4, disk.stand), *((k, watch) for k in range(n // 4 + 1, n)))
    threading.Timer(n / 10 + 4, disk.go).start()
    result, _ = record(
        drive, folder / "rec", lockstep=False, during=during, write=disk, queue_bytes=queue_bytes
    )
    recording = Recording(folder / "rec")
    lost = 2 * n - sum(len(sequences(recording, eye)) for eye in Eye)
    counted = hubs[0].recording.health.dropped_images
    return Row(
        "disk stands still, queue full",
        f"queue {max(fills):.0%} of its {queue_bytes // 1000} kB, {lost} images lost, "
        f"{counted} counted",
        "bounded; all taken by capture; each loss counted",
        result.frames == [n, n] and 0 < lost == counted and max(fills) <= 1.0,
    )


def standing_estimator(drive: Path, n: int, folder: Path) -> Row:
    """The estimator stops over its first window and goes on after the last frame."""
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
        "estimator stands still",
        f"{waiting[0]} windows waited, {result.submaps} of {result.windows} solved in the end, "
        f"{loop_figures(folder / 'rec')}",
        f"no frame lost, at most {INBOX_WINDOWS + 1} windows wait",
        kept and 0 < waiting[0] <= INBOX_WINDOWS + 1,
    )


def slow_from_the_start(drive: Path, n: int, folder: Path) -> Row:
    """The first sub-map comes too late to follow, and windows come faster than they are solved."""
    first: list[float] = []

    def watch(hub: Hub, _: str) -> None:
        if hub.result.poses and not first:
            first.append(hub.result.frames[0] / 10)

    with slow_estimator():
        result, _ = record(drive, folder / "rec", lockstep=False, during=watch)
    # the window in hand when the first is through, and the way to now
    limit_s = FIRST_S + 2 * LATER_S + 2
    kept = result.frames == [n, n] and result.unrecorded == 0 and all_frames(folder / "rec", n)
    when = f"first pose after {first[0]:.1f} s" if first else "no pose"
    return Row(
        f"estimator slow from the start: {FIRST_S:.0f} s, then {LATER_S:.0f} s a window",
        f"{when}, {result.poses} poses, {len(result.windows_left_to_map)} of {result.windows} "
        "windows left to map",
        f"no frame lost; a pose within {limit_s:.0f} s",
        kept and bool(first) and first[0] <= limit_s,
    )


def standing_tracker(drive: Path, n: int, folder: Path) -> Row:
    """The tracker stops for half of the drive: its ring fills, frames are recorded all the same."""

    def stop(hub: Hub) -> None:
        os.kill(hub.tracker.child.pid, signal.SIGSTOP)

    def go(hub: Hub) -> None:
        os.kill(hub.tracker.child.pid, signal.SIGCONT)

    during = AfterFrames((n // 4, stop), (3 * n // 4, go))
    result, _ = record(drive, folder / "rec", lockstep=False, during=during)
    kept = result.frames == [n, n] and result.unrecorded == 0 and all_frames(folder / "rec", n)
    return Row(
        "tracker stands still",
        f"{result.untracked} frames recorded but not tracked, {loop_figures(folder / 'rec')}",
        "no frame lost; what was not tracked is counted",
        kept and 0 < result.untracked < 2 * n,
    )


def stalled_serial(drive: Path, n: int, folder: Path) -> Row:
    """Nobody reads at the far end of the line, and no buffer is left."""
    far, near = os.openpty()
    config = config_for(drive)
    port = SerialPort(os.ttyname(near), 115_200)
    publisher = PosePublisher(port, PoseOutputConfig(port=port.path), spacing_known=True)
    line = SerialOutput(port, publisher, time.monotonic_ns)
    # the kernel's own buffer would take some seconds of poses
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
        "serial reader stalled",
        f"{dropped} messages dropped, {result.poses} poses recorded, "
        f"{loop_figures(folder / 'rec')}",
        "no frame lost; what the line did not take is counted",
        kept and 0 < reported <= dropped == result.output_losses["serial"] and result.poses > 0,
    )
