"""The kit under test: two cameras as configured, or a folder replayed in their place."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from calm_edge.config import Config
from calm_edge.daemon.source import Source, live, of_sequence
from device.camera_thread import CameraState, CameraThread
from device.errors import DeviceError
from device.frame import Frame


@dataclass(frozen=True, slots=True)
class Kit:
    """config_file: of the kit, None for defaults. sequence: a folder in place of cameras.

    out: where tests may write. minutes: of the soak.
    """

    config: Config
    config_file: Path | None
    sequence: Path | None
    out: Path
    minutes: float = 10.0

    def source(self) -> Source:
        """Open the source of its frames; raises CameraError, SequenceError."""
        if self.sequence is None:
            return live(self.config)
        return of_sequence(self.sequence, True)

    def absent(self) -> str:
        """Return why there are not two cameras to test, in words; empty when there are."""
        if self.sequence is not None:
            return ""
        from device.drivers.v4l2_nodes import list_devices

        drivers = {
            text.partition(":")[0]
            for text in (self.config.capture.primary, self.config.capture.assistant)
        }
        if drivers != {"v4l2"}:
            return ""
        try:
            found = len(list_devices())
        except DeviceError as error:
            return str(error)
        return "" if found >= 2 else f"{found} V4L2 cameras on this machine, two are needed"

    def record_command(self, out: Path) -> list[str]:
        """Return the command line that records this kit into a new folder."""
        command = [sys.executable, "-m", "calm_edge.cli", "record", "--out", str(out)]
        if self.config_file is not None:
            command += ["--config", str(self.config_file)]
        if self.sequence is not None:
            command += ["--sequence", str(self.sequence)]
        return command


@dataclass(slots=True)
class Seen:
    """The frames of one eye's thread. arrived_ns: when each arrived, on the source's clock."""

    thread: CameraThread
    frames: list[Frame] = field(default_factory=list)
    arrived_ns: list[int] = field(default_factory=list)


@contextmanager
def running(kit: Kit) -> Iterator[tuple[Source, tuple[Seen, Seen]]]:
    """Run both cameras, each in its thread; raises CameraError."""
    source = kit.source()
    both = [Seen(CameraThread(camera)) for camera in source.open()]
    try:
        for seen in both:
            seen.thread.start()
        yield source, (both[0], both[1])
    finally:
        for seen in both:
            seen.thread.stop()


def watch(
    kit: Kit, duration_s: float, sleep: Callable[[float], None] = time.sleep
) -> tuple[Seen, Seen]:
    """Collect the frames of both eyes for a while, without their pictures; raises CameraError."""
    with running(kit) as (source, both):
        end = time.monotonic() + duration_s
        while time.monotonic() < end and any(s.thread.state is CameraState.RUNNING for s in both):
            for seen in both:
                now_ns = source.clock.now_ns()
                for frame in seen.thread.drain():
                    seen.frames.append(Frame(frame.eye, frame.sequence, frame.t_ns, b""))
                    seen.arrived_ns.append(now_ns)
            sleep(0.002)
    return both
