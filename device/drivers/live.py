"""Base class of live cameras: reading, reconnecting, delayed locking of controls, counters."""

from __future__ import annotations

import logging
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from device.arrival import ArrivalCheck
from device.camera import CameraSpec, CameraStats
from device.clock import NS_PER_S, Clock
from device.errors import CameraError
from device.frame import Frame
from device.rate_meter import RateMeter, deviation
from device.stream import Stream

log = logging.getLogger(__name__)

_RETRY_NS = NS_PER_S
# time for automatic exposure and focus to converge before they are locked
_SETTLE_NS = 2 * NS_PER_S
# a streaming camera without a usable image for this long is reopened: its firmware has hung
_SILENT_NS = 3 * NS_PER_S
# relative change of the measured rate that is written to the settings
_RATE_CHANGE = 0.1


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
        self._usable_ns = 0
        self._unusable = 0
        self._warned = False
        self._meter = RateMeter()
        self._measured: dict[str, float] = {}
        self._rate_remarks: set[str] = set()
        self._sequence_offset = 0
        self._needs_offset = False
        self._remarks: tuple[str, ...] = ()
        self._stream = Stream()
        self._arrival = ArrivalCheck()

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
        """Mode and controls as read back when the device was last opened or locked.

        measured_hz: rate of the images, once it has been measured.
        """

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
        self._usable_ns = self._clock.now_ns()
        self._unusable = 0
        self._arrival = ArrivalCheck()
        self._settle_ns = self._usable_ns + _SETTLE_NS
        log.info("%s: %s", self.spec.name, self._described())

    def _described(self) -> str:
        return ", ".join(f"{k} {v}" for k, v in self.settings.items() if v not in ("", "absent"))

    def _disconnect(self) -> None:
        self._is_open = False
        self._meter.restart()
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
                self._meter.restart()
                if self._lock_settled():
                    log.info("%s: locked: %s", self.spec.name, self._described())
            left_s = (self._usable_ns + _SILENT_NS - now_ns) / NS_PER_S
            raw = self._read_device(max(0.0, min(timeout_s, left_s)))
            now_ns = self._clock.now_ns()
            if raw is not None and raw.image is None:
                self._unusable += 1
                self._stream.lose(self._sequence(raw.sequence))
            if (raw is None or raw.image is None) and now_ns - self._usable_ns >= _SILENT_NS:
                raise CameraError(self._silence())
        except CameraError as error:
            # once, not every few seconds, until the camera delivers again
            log.log(
                logging.DEBUG if self._warned else logging.WARNING,
                "%s; searching for it every second",
                error,
            )
            self._warned = True
            self._disconnect()
            self._retry_ns = self._clock.now_ns() + _RETRY_NS
            return None
        if raw is None or raw.image is None:
            return None
        self._usable_ns, self._unusable, self._warned = now_ns, 0, False
        t_ns = raw.t_ns
        if t_ns is None or not self._arrival.usable(t_ns, now_ns):
            self._stream.count("host_stamped")
            t_ns = now_ns
        if self._arrival.reason:
            self._remark(
                f"{self.spec.name}: its stamps are of another clock ({self._arrival.reason} on "
                "arrival); the times of arrival are used"
            )
        frame = Frame(self.spec.eye, self._sequence(raw.sequence), t_ns, raw.image)
        frame = self._stream.admit(frame, now_ns)
        hz = self._meter.add(frame.sequence, frame.t_ns) if self._settle_ns is None else None
        if hz is not None:
            self._note_rate(hz)
        return frame

    def _silence(self) -> str:
        """Why the camera is reopened although it streams."""
        seconds = f"{_SILENT_NS / NS_PER_S:g} s"
        if self._unusable:
            return (
                f"{self.spec.name}: no usable image for {seconds} ({self._unusable} corrupt), "
                "reopened; try another cable or USB port"
            )
        return f"{self.spec.name}: no frame for {seconds}"

    def _note_rate(self, hz: float) -> None:
        """Write the measured rate to the settings if it has changed, and remark if it is wrong."""
        before = self._measured.get("measured_hz", 0.0)
        if abs(hz - before) <= _RATE_CHANGE * before:
            return
        self._measured = {"measured_hz": round(hz, 1)}
        wrong = deviation(hz, self.spec.rate_hz, float(self.settings.get("rate_hz", 0.0)))
        if wrong and wrong.kind not in self._rate_remarks:
            self._rate_remarks.add(wrong.kind)
            self._remark(f"{self.spec.name}: {wrong.text}")

    def _sequence(self, sequence: int) -> int:
        """Continue the sequence numbers after a reconnect, when the device restarts at 0."""
        if self._needs_offset:
            last = self._stream.last_sequence
            self._sequence_offset = 0 if last is None else last + 1 - sequence
            self._needs_offset = False
        return sequence + self._sequence_offset
