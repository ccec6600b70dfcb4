"""A thread per camera that queues its frames until they are drained."""

from __future__ import annotations

import logging
import threading
from collections import deque
from enum import StrEnum

from device import realtime
from device.camera import Camera
from device.errors import DeviceError
from device.frame import Frame

log = logging.getLogger(__name__)


class CameraState(StrEnum):
    """State of a camera thread. FINISHED: a replay ended. FAILED: the thread ended on an error."""

    RUNNING = "running"
    FINISHED = "finished"
    FAILED = "failed"
    STOPPED = "stopped"


class CameraThread:
    """Read a live or paced camera in a thread, into a bounded queue that drops its oldest frame.

    In lockstep read the camera directly: an unpaced replay would overflow the queue.
    realtime_priority: as in `realtime.request`; if refused, a warning is logged.
    """

    def __init__(
        self,
        camera: Camera,
        capacity: int = 64,
        poll_s: float = 0.1,
        realtime_priority: int = 0,
    ) -> None:
        self.camera = camera
        self.state = CameraState.STOPPED
        self.error: str | None = None
        self.overflow = 0
        self._queue: deque[Frame] = deque()
        self._capacity = capacity
        self._poll_s = poll_s
        self._realtime_priority = realtime_priority
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Open the camera in the calling thread (raises CameraError), then start reading."""
        self.camera.start()
        self.state = CameraState.RUNNING
        name = f"camera-{self.camera.spec.eye.name.lower()}"
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    @property
    def waiting(self) -> int:
        """Number of queued frames."""
        with self._lock:
            return len(self._queue)

    def drain(self) -> list[Frame]:
        """Return all frames since the last call, in order."""
        with self._lock:
            frames = list(self._queue)
            self._queue.clear()
        return frames

    def stop(self) -> None:
        """End the thread and close the camera; queued frames can still be drained."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        if self.state is CameraState.RUNNING:
            self.state = CameraState.STOPPED

    def _run(self) -> None:
        refused = realtime.request(self._realtime_priority)
        if refused:
            log.warning("%s: %s", self.camera.spec.name, refused)
        try:
            while not self._stop.is_set():
                frame = self.camera.read(self._poll_s)
                if frame is not None:
                    self._collect(frame)
                elif self.camera.exhausted:
                    self.state = CameraState.FINISHED
                    return
        except Exception as error:
            # an error in one camera must not stop the other, the recording or the pose
            expected = isinstance(error, DeviceError)
            self.error = str(error) if expected else f"{self.camera.spec.name}: {error!r}"
            self.state = CameraState.FAILED
            if not expected:
                log.exception("%s: the camera thread ended", self.camera.spec.name)
        finally:
            self.camera.stop()

    def _collect(self, frame: Frame) -> None:
        with self._lock:
            if len(self._queue) == self._capacity:
                self._queue.popleft()
                self.overflow += 1
            self._queue.append(frame)
