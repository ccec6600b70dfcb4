"""One thread a camera: frames are collected when they come and handed over when asked."""

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
    """failed: the thread ended on an error; finished: on the end of the frames."""

    RUNNING = "running"
    FINISHED = "finished"
    FAILED = "failed"
    STOPPED = "stopped"


class CameraThread:
    """Reads a live or paced camera into a bounded queue; its oldest frame gives way when full.

    For frames as fast as asked (lockstep) read the camera itself: here they would overflow.
    realtime_priority: see `realtime.request`; a refusal is logged and changes nothing else.
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
        """Opens the camera here, so that CameraError reaches the caller, then starts to read."""
        self.camera.start()
        self.state = CameraState.RUNNING
        name = f"camera-{self.camera.spec.eye.name.lower()}"
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    @property
    def waiting(self) -> int:
        """Frames collected and not yet drained."""
        with self._lock:
            return len(self._queue)

    def drain(self) -> list[Frame]:
        """Every frame since the last drain, in order."""
        with self._lock:
            frames = list(self._queue)
            self._queue.clear()
        return frames

    def stop(self) -> None:
        """Ends the thread and closes the camera; frames already collected can still be drained."""
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
            # whatever one camera does, the other camera, the recording and the pose go on
            named = isinstance(error, DeviceError)
            self.error = str(error) if named else f"{self.camera.spec.name}: {error!r}"
            self.state = CameraState.FAILED
            if not named:
                log.exception("%s: the camera thread ended", self.camera.spec.name)
        finally:
            self.camera.stop()

    def _collect(self, frame: Frame) -> None:
        with self._lock:
            if len(self._queue) == self._capacity:
                self._queue.popleft()
                self.overflow += 1
            self._queue.append(frame)
