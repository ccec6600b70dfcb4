"""Watch two cameras for a while, each read in a thread of its own."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

from device.camera import Camera, refuse_same_device
from device.camera_thread import CameraState, CameraThread
from device.clock import Clock
from device.frame import Frame


@dataclass(slots=True)
class Seen:
    """The frames of one camera. arrived_ns: when each arrived, on the clock of their stamps."""

    thread: CameraThread
    frames: list[Frame] = field(default_factory=list)
    arrived_ns: list[int] = field(default_factory=list)

    @property
    def rate_hz(self) -> float:
        """Measured rate of the frames, 0 if there are fewer than two."""
        t_ns = [frame.t_ns for frame in self.frames]
        return (len(t_ns) - 1) * 1e9 / (t_ns[-1] - t_ns[0]) if len(t_ns) > 1 else 0.0


@contextmanager
def running(cameras: Sequence[Camera]) -> Iterator[tuple[Seen, ...]]:
    """Run cameras, each in its thread; raises CameraError."""
    seen = tuple(Seen(CameraThread(camera)) for camera in cameras)
    try:
        for each in seen:
            each.thread.start()
        refuse_same_device(cameras)
        yield seen
    finally:
        for each in seen:
            each.thread.stop()


def collect(
    seen: Sequence[Seen],
    clock: Clock,
    duration_s: float,
    *,
    pictures: int = 0,
    sleep: Callable[[float], None] = time.sleep,
) -> None:
    """Collect the frames of running cameras for a while.

    clock: of the frames' stamps. pictures: how many of the last frames of each keep their picture.
    """
    end = time.monotonic() + duration_s
    while time.monotonic() < end and any(s.thread.state is CameraState.RUNNING for s in seen):
        for each in seen:
            now_ns = clock.now_ns()
            for frame in each.thread.drain():
                each.frames.append(frame)
                each.arrived_ns.append(now_ns)
                if len(each.frames) > pictures:
                    old = len(each.frames) - pictures - 1
                    each.frames[old] = dataclasses.replace(each.frames[old], image=b"")
        sleep(0.002)
