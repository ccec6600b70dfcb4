"""One OAK device and the cameras on its sockets: they start, fail and come back together."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import timedelta
from typing import Any, Protocol
from weakref import WeakValueDictionary

from device.camera import CameraControls


@dataclass(frozen=True, slots=True)
class Wanted:
    """What is asked of one socket. raw: pictures uncompressed, else JPEG made by the device."""

    socket: str
    width_px: int
    height_px: int
    rate_hz: float
    raw: bool
    controls: CameraControls


class Queue(Protocol):
    """depthai.MessageQueue: the part we use."""

    def get(self, timeout: timedelta, /) -> Any:
        """The next message, None after the timeout; raises when it is closed."""
        ...


class Pipeline(Protocol):
    """A pipeline that runs on one device."""

    device: str
    queues: Mapping[str, Queue]

    def alive(self) -> bool:
        """False once the device is lost."""
        ...

    def control(self, socket: str, controls: CameraControls) -> None:
        """Sends numbers that are to be held from now on."""
        ...

    def close(self) -> None:
        """Stops the pipeline and lets go of the device."""
        ...


# the id of a device (empty: the first there is) and what its sockets are to give; CameraError
Factory = Callable[[str, Sequence[Wanted]], Pipeline]


class Rig:
    """Owner of one device's pipeline. A pipeline cannot grow once it runs: cameras join before the
    first one starts; for one that joins later it is built anew, and the others come back.
    """

    def __init__(self, device: str, factory: Factory) -> None:
        self._device, self._factory = device, factory
        self._lock = threading.Lock()
        self._wanted: dict[str, Wanted] = {}
        self._active: set[str] = set()
        self._pipeline: Pipeline | None = None

    def join(self, wanted: Wanted) -> None:
        """Says what a socket is to give, from the next build on."""
        with self._lock:
            self._wanted[wanted.socket] = wanted

    def enter(self, socket: str) -> Pipeline:
        """The running pipeline with this socket in it, built if need be; raises CameraError."""
        with self._lock:
            pipeline = self._pipeline
            if pipeline is not None and (socket not in pipeline.queues or not pipeline.alive()):
                self._end()
            if self._pipeline is None:
                self._pipeline = self._factory(self._device, list(self._wanted.values()))
            self._active.add(socket)
            return self._pipeline

    def lost(self, pipeline: Pipeline) -> None:
        """A camera found it dead; one that is already replaced is left alone."""
        with self._lock:
            if self._pipeline is pipeline:
                self._end()

    def leave(self, socket: str) -> None:
        """A camera stops; the last one ends the pipeline."""
        with self._lock:
            self._active.discard(socket)
            if not self._active:
                self._end()

    def _end(self) -> None:
        pipeline, self._pipeline = self._pipeline, None
        if pipeline is not None:
            pipeline.close()


_RIGS: WeakValueDictionary[tuple[str, Factory], Rig] = WeakValueDictionary()


def shared(device: str, factory: Factory) -> Rig:
    """The rig of a device: one for both cameras on it."""
    rig = _RIGS.get((device, factory))
    if rig is None:
        rig = _RIGS[device, factory] = Rig(device, factory)
    return rig
