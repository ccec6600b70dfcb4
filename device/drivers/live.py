"""Base class of live cameras: reading, reconnecting, delayed locking of controls, counters."""

from __future__ import annotations

import logging
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from device.camera import CameraSpec, CameraStats
from device.clock import NS_PER_S, Clock
from device.errors import CameraError
from device.frame import Frame
from device.stream import Stream

log = logging.getLogger(__name__)

_RETRY_NS = NS_PER_S
# time for automatic exposure and focus to converge before they are locked
_SETTLE_NS = 2 * NS_PER_S
# a streaming camera without frames for this long is reopened: its firmware has hung
_SILENT_NS = 3 * NS_PER_S


@dataclass(frozen=True, slots=True)
class RawFrame:
    """Frame as read from the device.

    sequence: the device's frame counter, which may restart when the device is reopened. t_ns: stamp
    of the device, None if it gave no usable one. image: as in Frame; None if the buffer was
    unusable.
    """

    sequence: int
    t_ns: int | None
    image: NDArray[np.uint8] | bytes | None


class LiveCamera(ABC):
    """Base class of cameras on a device that may be unplugged.

    A lost device is searched for every second.

    clock: CLOCK_MONOTONIC, the clock of the stamps.
    """

    exhausted = False

    def __init__(self, spec: CameraSpec, clock: Clock) -> None:
        self.spec = spec
        self._clock = clock
        self._running = False
        self._is_open = False
        self._retry_ns = 0
        self._settle_ns: int | None = None
        self._last_frame_ns = 0
        self._sequence_offset = 0
        self._needs_offset = False
        self._remarks: tuple[str, ...] = ()
        self._stream = Stream()

    @abstractmethod
    def _open(self) -> None:
        """Find the device by its identity and start streaming; raises CameraError."""

    @abstractmethod
    def _close(self) -> None:
        """Release the device; may be called repeatedly."""

    @abstractmethod
    def _read_device(self, timeout_s: float) -> RawFrame | None:
        """Return the next image, None after timeout_s; raises CameraError if the device is lost."""

    @abstractmethod
    def _lock_settled(self) -> bool:
        """Lock the `auto-then-lock` controls; False if there are none to lock."""

    @property
    @abstractmethod
    def settings(self) -> Mapping[str, int | float | str]:
        """Mode and controls as read back when the device was last opened or locked."""

    @property
    def remarks(self) -> tuple[str, ...]:
        """Requests that the device did not fulfil since start()."""
        return self._remarks

    @property
    def connected(self) -> bool:
        """True while the device is open: not before start(), while it is lost or after stop()."""
        return self._is_open

    def start(self) -> None:
        """Find and open the device and start streaming; raises CameraError."""
        if self._running:
            return
        self._connect()
        self._running = True

    def read(self, timeout_s: float) -> Frame | None:
        """Return the next frame; while the device is lost, search for it every second."""
        limit_ns = self._clock.now_ns() + math.floor(timeout_s * NS_PER_S)
        while self._running:
            left_ns = max(0, limit_ns - self._clock.now_ns())
            if not self._is_open:
                self._wait_for_return(limit_ns)
            elif (frame := self._read_once(left_ns / NS_PER_S)) is not None:
                return frame
            if self._clock.now_ns() >= limit_ns:
                return None
        return None

    def stop(self) -> None:
        """Stop streaming and close the device."""
        self._running = False
        self._disconnect()

    def stats(self) -> CameraStats:
        """Return the counters."""
        return self._stream.stats

    def _remark(self, line: str) -> None:
        """Add a remark, unless an earlier connection has added it already."""
        if line not in self._remarks:
            self._remarks += (line,)

    def _connect(self) -> None:
        self._open()
        self._is_open = self._needs_offset = True
        self._last_frame_ns = self._clock.now_ns()
        self._settle_ns = self._last_frame_ns + _SETTLE_NS
        log.info("%s: %s", self.spec.name, self._described())

    def _described(self) -> str:
        return ", ".join(f"{k} {v}" for k, v in self.settings.items() if v not in ("", "absent"))

    def _disconnect(self) -> None:
        self._is_open = False
        self._close()

    def _wait_for_return(self, limit_ns: int) -> None:
        self._clock.sleep_until_ns(min(limit_ns, self._retry_ns))
        if self._clock.now_ns() < self._retry_ns:
            return
        try:
            self._connect()
        except CameraError as error:
            log.debug("%s", error)
            self._retry_ns = self._clock.now_ns() + _RETRY_NS
            return
        self._stream.count("reconnects")
        log.info("%s: reconnected", self.spec.name)

    def _read_once(self, timeout_s: float) -> Frame | None:
        now_ns = self._clock.now_ns()
        try:
            if self._settle_ns is not None and now_ns >= self._settle_ns:
                self._settle_ns = None
                if self._lock_settled():
                    log.info("%s: locked: %s", self.spec.name, self._described())
            left_s = (self._last_frame_ns + _SILENT_NS - now_ns) / NS_PER_S
            raw = self._read_device(max(0.0, min(timeout_s, left_s)))
            now_ns = self._clock.now_ns()
            if raw is None and now_ns - self._last_frame_ns >= _SILENT_NS:
                raise CameraError(f"{self.spec.name}: no frame for {_SILENT_NS / NS_PER_S:g} s")
        except CameraError as error:
            log.warning("%s; searching for it every second", error)
            self._disconnect()
            self._retry_ns = self._clock.now_ns() + _RETRY_NS
            return None
        if raw is None:
            return None
        self._last_frame_ns = now_ns
        if raw.image is None:
            self._stream.count("corrupt")
            return None
        if raw.t_ns is None:
            self._stream.count("host_stamped")
        t_ns = now_ns if raw.t_ns is None else raw.t_ns
        frame = Frame(self.spec.eye, self._sequence(raw.sequence), t_ns, raw.image)
        return self._stream.admit(frame, now_ns)

    def _sequence(self, sequence: int) -> int:
        """Continue the sequence numbers after a reconnect, when the device restarts at 0."""
        if self._needs_offset:
            newest = self._stream.newest
            self._sequence_offset = newest.sequence + 1 - sequence if newest else 0
            self._needs_offset = False
        return sequence + self._sequence_offset
