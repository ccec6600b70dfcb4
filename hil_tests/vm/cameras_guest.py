"""Runs in the guest: both virtual cameras in threads, as in `record`, with each fault injected."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

from device.camera import CameraControls, CameraSpec
from device.camera_thread import CameraThread
from device.clock import SystemClock
from device.drivers.v4l2 import V4l2Camera
from device.drivers.v4l2_controls import set_control
from device.drivers.v4l2_ioctl import LinuxVideoIO
from device.drivers.v4l2_nodes import list_devices
from device.errors import CameraError
from device.frame import Eye, Frame

# controls of vivid that inject faults
DROP_PERCENT, DISCONNECT, BUFFER_ERROR, FATAL = 0x00F0F040, 0x00F0F041, 0x00F0F042, 0x00F0F046
DRIVER = Path("/sys/bus/platform/drivers/vivid")
ADDRESSES = "platform:vivid-000", "platform:vivid-001"
RATE_HZ = 10.0


def row(what: str, good: bool, seen: str) -> None:
    print(f"ROW {what}|{'pass' if good else 'FAIL'}|{seen}", flush=True)


def camera(eye: Eye, controls: CameraControls | None = None) -> V4l2Camera:
    controls = controls or CameraControls()
    spec = CameraSpec(eye, "v4l2", ADDRESSES[eye], 320, 180, RATE_HZ, controls=controls)
    return V4l2Camera(spec, SystemClock())


class Eyes:
    """Both cameras, running; `frames`: those of each so far."""

    def __init__(self) -> None:
        self.cameras = [camera(eye) for eye in Eye]
        self.threads = [CameraThread(c) for c in self.cameras]
        self.frames: tuple[list[Frame], list[Frame]] = ([], [])

    def __enter__(self) -> Eyes:
        for thread in self.threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        for thread in self.threads:
            thread.stop()

    def until(self, done: Callable[[], bool], limit_s: float = 30.0) -> float:
        """Drain both until `done`; returns the time taken [s], infinite when the limit passed."""
        start = time.monotonic()
        while time.monotonic() - start < limit_s:
            for thread, frames in zip(self.threads, self.frames, strict=True):
                frames.extend(Frame(f.eye, f.sequence, f.t_ns, b"") for f in thread.drain())
            if done():
                return time.monotonic() - start
            time.sleep(0.05)
        return float("inf")

    def more(self, eye: int, n: int) -> Callable[[], bool]:
        """Return a condition: this eye has n more frames than now."""
        goal = len(self.frames[eye]) + n
        return lambda: len(self.frames[eye]) >= goal

    def press(self, eye: int, control: int, value: int = 1) -> bool:
        """Inject a fault into one camera."""
        io = LinuxVideoIO()
        fd = io.open(str(self.cameras[eye].settings["path"]))
        try:
            return set_control(io, fd, control, value)
        finally:
            io.close(fd)


def enumerated() -> None:
    nodes, all_nodes = list_devices(), LinuxVideoIO().nodes()
    found = [node.address for node in nodes]
    good = found == list(ADDRESSES) and len(all_nodes) > len(nodes)
    row("enumeration", good, f"{found} of {len(all_nodes)} nodes, the others are metadata")


def controls_and_busy() -> None:
    held = camera(Eye.PRIMARY, CameraControls(gain=77))
    held.start()
    row("gain set and read back", held.settings["gain"] == 77, f"{held.settings['gain']}")
    try:
        camera(Eye.PRIMARY).start()
        row("camera in use", False, "a second start succeeded")
    except CameraError as error:
        row("camera in use", f"process {os.getpid()}" in str(error), str(error))
    held.stop()


def running(eyes: Eyes) -> None:
    took = eyes.until(lambda: all(len(f) >= 20 for f in eyes.frames))
    increasing = all(b.t_ns > a.t_ns for f in eyes.frames for a, b in pairwise(f))
    stats = [c.stats() for c in eyes.cameras]
    seen = f"20 frames of each in {took:.1f} s, {[s.clamped for s in stats]} stamps clamped"
    row("both stream, stamps increase", took < 30 and increasing, seen)


def drops(eyes: Eyes) -> None:
    eyes.press(0, DROP_PERCENT, 40)
    eyes.until(lambda: False, 1.0)
    # drops counted before may still be in flight: leave out the next frames
    before, start = eyes.cameras[0].stats().drops, len(eyes.frames[0]) + 2
    eyes.until(eyes.more(0, 23))
    eyes.press(0, DROP_PERCENT, 0)
    part = eyes.frames[0][start : start + 21]
    counted = part[-1].sequence - part[0].sequence - (len(part) - 1)
    # the camera stamps at a fixed rate: the elapsed time gives the number of frames independently
    lapsed = (part[-1].t_ns - part[0].t_ns) / 1e9 * RATE_HZ
    missing = round(lapsed) - (len(part) - 1)
    total = eyes.cameras[0].stats().drops - before
    good = counted > 0 and abs(counted - missing) <= 1 and total >= counted
    row("dropped buffers counted", good, f"{counted} by sequence, {missing} by time, of 40 % lost")


def buffer_error(eyes: Eyes) -> None:
    before = eyes.cameras[1].stats().corrupt
    eyes.press(1, BUFFER_ERROR)
    eyes.until(eyes.more(1, 5))
    corrupt = eyes.cameras[1].stats().corrupt - before
    row("buffer error", corrupt >= 1 and eyes.cameras[1].connected, f"{corrupt} passed over")


def lost_one(eyes: Eyes, what: str, control: int) -> None:
    """Make one camera fail: the other's frames continue, the first reconnects."""
    before, other = eyes.cameras[0].stats().reconnects, len(eyes.frames[1])
    eyes.press(0, control)
    gone = eyes.until(lambda: not eyes.cameras[0].connected)
    back = eyes.until(lambda: eyes.cameras[0].stats().reconnects > before)
    flows = eyes.until(eyes.more(0, 3))
    others = len(eyes.frames[1]) - other
    good = max(gone, back, flows) < 30 and others > 0 and eyes.cameras[1].stats().reconnects == 0
    row(what, good, f"back after {gone + back:.1f} s; {others} frames of the other meanwhile")


def renumbered(eyes: Eyes) -> None:
    before = [str(c.settings["path"]) for c in eyes.cameras]
    counts = [c.stats().reconnects for c in eyes.cameras]
    # an open file keeps the number of the old node in use
    stale = [os.open(path, os.O_RDWR | os.O_NONBLOCK) for path in before]
    (DRIVER / "unbind").write_text("vivid.0")
    gone = eyes.until(lambda: not any(c.connected for c in eyes.cameras))
    (DRIVER / "bind").write_text("vivid.0")
    back = eyes.until(
        lambda: all(c.stats().reconnects > n for c, n in zip(eyes.cameras, counts, strict=True))
    )
    flows = max(eyes.until(eyes.more(eye, 3)) for eye in (0, 1))
    after = [str(c.settings["path"]) for c in eyes.cameras]
    roles = [c.settings["address"] for c in eyes.cameras] == list(ADDRESSES)
    good = max(gone, back, flows) < 30 and roles and not set(after) & set(before)
    row("unplug and return renumbered", good, f"{before} -> {after} in {back:.1f} s, same roles")
    for fd in stale:
        os.close(fd)


def main() -> None:
    enumerated()
    controls_and_busy()
    with Eyes() as eyes:
        running(eyes)
        drops(eyes)
        buffer_error(eyes)
        lost_one(eyes, "disconnected", DISCONNECT)
        lost_one(eyes, "fatal error", FATAL)
        renumbered(eyes)
        ended = [t.error for t in eyes.threads if t.error]
    row("no camera thread ended", not ended, "; ".join(ended) or "both ran to the end")


if __name__ == "__main__":
    main()
