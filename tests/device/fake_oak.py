"""A fake OAK device: depthai's own messages, in queues driven by a manual clock."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from datetime import timedelta
from typing import Any

import numpy as np

from device.camera import CameraControls
from device.drivers.oak import load
from device.drivers.oak_pipeline import SocketRequest
from device.errors import CameraError
from tests.manual_clock import ManualClock


def encoded(sequence: int, t_ns: int, data: bytes) -> Any:
    """A depthai.EncodedFrame as sent by the device's JPEG encoder."""
    message = load().EncodedFrame()
    message.setData(np.frombuffer(data, np.uint8))
    message.setSequenceNum(sequence)
    message.setTimestamp(timedelta(microseconds=t_ns // 1000))
    return message


class FakeQueue:
    """Queue of (due time, message); once `closed`, get() raises as depthai's does."""

    def __init__(self, clock: ManualClock) -> None:
        self._clock = clock
        self.messages: deque[tuple[int, Any]] = deque()
        self.closed = False

    def get(self, timeout: timedelta, /) -> Any:
        if self.closed:
            raise RuntimeError("MessageQueue was closed")
        limit_ns = self._clock.now_ns() + timeout // timedelta(microseconds=1) * 1000
        due_ns = self.messages[0][0] if self.messages else limit_ns + 1
        self._clock.sleep_until_ns(min(due_ns, limit_ns))
        return self.messages.popleft()[1] if due_ns <= limit_ns else None


class FakePipeline:
    def __init__(self, device: str, queues: dict[str, FakeQueue]) -> None:
        self.device = device
        self.queues = queues
        self.sent: list[tuple[str, CameraControls]] = []
        self.closed = False
        self.dead = False

    def alive(self) -> bool:
        return not (self.dead or self.closed)

    def control(self, socket: str, controls: CameraControls) -> None:
        self.sent.append((socket, controls))

    def close(self) -> None:
        self.closed = True
        for queue in self.queues.values():
            queue.closed = True


class FakeOak:
    """A device with an id. `film` adds messages to a socket's queue, also before it is built."""

    def __init__(self, clock: ManualClock, device: str = "OAK1") -> None:
        self.clock, self.device = clock, device
        self.present = True
        self.built: list[tuple[FakePipeline, list[SocketRequest]]] = []
        self._filmed: dict[str, list[tuple[int, Any]]] = {}

    def factory(self, device: str, wanted: Sequence[SocketRequest]) -> FakePipeline:
        if not self.present or device not in ("", self.device):
            raise CameraError("no OAK device found")
        queues = {each.socket: FakeQueue(self.clock) for each in wanted}
        for socket, queue in queues.items():
            queue.messages.extend(self._filmed.pop(socket, []))
        pipeline = FakePipeline(self.device, queues)
        self.built.append((pipeline, list(wanted)))
        return pipeline

    @property
    def pipeline(self) -> FakePipeline:
        """The pipeline built last."""
        return self.built[-1][0]

    def film(self, socket: str, due_ns: int, message: Any) -> None:
        """Add a message to a socket, or keep it until the next pipeline is built."""
        if self.built and self.pipeline.alive():
            self.pipeline.queues[socket].messages.append((due_ns, message))
        else:
            self._filmed.setdefault(socket, []).append((due_ns, message))
