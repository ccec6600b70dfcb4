"""Share the depthai pipeline of one OAK device among the cameras on its sockets."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import timedelta
from typing import Any, Protocol
from weakref import WeakValueDictionary

from device.camera import CameraControls


@dataclass(frozen=True, slots=True)
class SocketRequest:
    """Image mode requested of one socket. raw: uncompressed, else JPEG encoded on the device."""

    socket: str
    width_px: int
    height_px: int
    rate_hz: float
    raw: bool
    controls: CameraControls


class Queue(Protocol):
    """Interface of a frame queue: the part of depthai.MessageQueue that is used."""

    def get(self, timeout: timedelta, /) -> Any:
        """Return the next message, None after the timeout; raises once the queue is closed."""
        ...


class Pipeline(Protocol):
    """A running pipeline of one device, with a queue of frames for each socket."""

    device: str
    queues: Mapping[str, Queue]

    def alive(self) -> bool:
        """False once the device is lost."""
        ...

    def control(self, socket: str, controls: CameraControls) -> None:
        """Set and lock the numeric controls of a socket."""
        ...

    def close(self) -> None:
        """Stop the pipeline and release the device."""
        ...


# creates the pipeline of a device id (empty: the first device) for the requests of its sockets;
# raises CameraError
Factory = Callable[[str, Sequence[SocketRequest]], Pipeline]


class SharedPipeline:
    """Build the one pipeline of a device on demand, for all cameras on the device's sockets.

    A running pipeline cannot be extended by a socket, so all cameras register before the first one
    starts. If one registers later, the pipeline is rebuilt and the other cameras reconnect.
    """

    def __init__(self, device: str, factory: Factory) -> None:
        self._device, self._factory = device, factory
        self._lock = threading.Lock()
        self._requests: dict[str, SocketRequest] = {}
        self._active: set[str] = set()
        self._pipeline: Pipeline | None = None

    def register(self, request: SocketRequest) -> None:
        """Set the request of a socket, in effect from the next build of the pipeline."""
        with self._lock:
            self._requests[request.socket] = request

    def acquire(self, socket: str) -> Pipeline:
        """Return a running pipeline with this socket, (re)built if needed; raises CameraError."""
        with self._lock:
            pipeline = self._pipeline
            if pipeline is not None and (socket not in pipeline.queues or not pipeline.alive()):
                self._end()
            if self._pipeline is None:
                self._pipeline = self._factory(self._device, list(self._requests.values()))
            self._active.add(socket)
            return self._pipeline

    def discard(self, pipeline: Pipeline) -> None:
        """Close a pipeline that no longer delivers frames, unless it has been replaced already."""
        with self._lock:
            if self._pipeline is pipeline:
                self._end()

    def release(self, socket: str) -> None:
        """Release a socket; the pipeline is closed when its last socket is released."""
        with self._lock:
            self._active.discard(socket)
            if not self._active:
                self._end()

    def _end(self) -> None:
        pipeline, self._pipeline = self._pipeline, None
        if pipeline is not None:
            pipeline.close()


_PIPELINES: WeakValueDictionary[tuple[str, Factory], SharedPipeline] = WeakValueDictionary()


def shared_pipeline(device: str, factory: Factory) -> SharedPipeline:
    """Return the one SharedPipeline of a device, created on first use."""
    pipeline = _PIPELINES.get((device, factory))
    if pipeline is None:
        pipeline = _PIPELINES[device, factory] = SharedPipeline(device, factory)
    return pipeline
