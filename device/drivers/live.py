"""What every live camera does alike: order, counts, silence, locking, and a way back when lost."""

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
# exposure and focus have found their values by then
_SETTLE_NS = 2 * NS_PER_S
# a camera that streams and sends nothing is opened anew: its firmware has hung
_SILENT_NS = 3 * NS_PER_S


@dataclass(frozen=True, slots=True)
class Taken:
    """What a driver fetched. sequence: as the device counts; it may begin anew when reopened.

    t_ns: None without a usable stamp. image: as in Frame, None of an unusable buffer.
    """

    sequence: int
    t_ns: int | None
    image: NDArray[np.uint8] | bytes | None


class LiveCamera(ABC):
    """A Camera on a device that may be lost: it is looked for by its identity each second.

    clock: CLOCK_MONOTONIC, which the stamps are told on.
    """

    exhausted = False

    def __init__(self, spec: CameraSpec, clock: Clock) -> None:
        self.spec = spec
        self._clock = clock
        self._running = False
        self._is_open = False
        self._retry_ns = 0
        self._settle_ns: int | None = None
        self._heard_ns = 0
        self._sequence_offset = 0
        self._needs_offset = False
        self._remarks: tuple[str, ...] = ()
        self._stream = Stream()

    @abstractmethod
    def _open(self) -> None:
        """Finds the device by its identity and starts it; raises CameraError."""

    @abstractmethod
    def _close(self) -> None:
        """Lets go of the device; may be repeated."""

    @abstractmethod
    def _take(self, timeout_s: float) -> Taken | None:
        """The next picture, None after timeout_s; raises CameraError when the device is lost."""

    @abstractmethod
    def _settle(self) -> bool:
        """Locks what was to find its value first; whether there was anything to lock."""

    @property
    @abstractmethod
    def settings(self) -> Mapping[str, int | float | str]:
        """What the device settled on, read back when it was last opened or locked."""

    @property
    def remarks(self) -> tuple[str, ...]:
        """What the device does not do as asked, since start()."""
        return self._remarks

    @property
    def connected(self) -> bool:
        """False before start, while the device is gone, and after stop."""
        return self._is_open

    def start(self) -> None:
        """Finds the device, opens it and starts the stream; raises CameraError."""
        if self._running:
            return
        self._connect()
        self._running = True

    def read(self, timeout_s: float) -> Frame | None:
        """The next frame; while the device is gone it is looked for each second."""
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

    def latest(self, max_age_ns: int) -> Frame | None:
        """The newest frame in the driver's buffers, or the last one read while it is fresh."""
        while self.read(0.0) is not None:
            pass
        return self._stream.fresh(self._clock.now_ns(), max_age_ns) if self._running else None

    def stop(self) -> None:
        """Stops the stream and closes the device."""
        self._running = False
        self._disconnect()

    def stats(self) -> CameraStats:
        """The counts so far."""
        return self._stream.stats

    def _remark(self, line: str) -> None:
        """Once, however often the camera comes back."""
        if line not in self._remarks:
            self._remarks += (line,)

    def _connect(self) -> None:
        self._open()
        self._is_open = self._needs_offset = True
        self._heard_ns = self._clock.now_ns()
        self._settle_ns = self._heard_ns + _SETTLE_NS
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
        log.info("%s: is back", self.spec.name)

    def _read_once(self, timeout_s: float) -> Frame | None:
        now_ns = self._clock.now_ns()
        try:
            if self._settle_ns is not None and now_ns >= self._settle_ns:
                self._settle_ns = None
                if self._settle():
                    log.info("%s: locked: %s", self.spec.name, self._described())
            patience_s = (self._heard_ns + _SILENT_NS - now_ns) / NS_PER_S
            taken = self._take(max(0.0, min(timeout_s, patience_s)))
            now_ns = self._clock.now_ns()
            if taken is None and now_ns - self._heard_ns >= _SILENT_NS:
                raise CameraError(f"{self.spec.name}: silent for {_SILENT_NS / NS_PER_S:g} s")
        except CameraError as error:
            log.warning("%s; looking for it every second", error)
            self._disconnect()
            self._retry_ns = self._clock.now_ns() + _RETRY_NS
            return None
        if taken is None:
            return None
        self._heard_ns = now_ns
        if taken.image is None:
            self._stream.count("corrupt")
            return None
        if taken.t_ns is None:
            self._stream.count("host_stamped")
        t_ns = now_ns if taken.t_ns is None else taken.t_ns
        frame = Frame(self.spec.eye, self._sequence(taken.sequence), t_ns, taken.image)
        return self._stream.admit(frame, now_ns)

    def _sequence(self, sequence: int) -> int:
        """Counts on after a reconnect, where the device begins at 0 again."""
        if self._needs_offset:
            newest = self._stream.newest
            self._sequence_offset = newest.sequence + 1 - sequence if newest else 0
            self._needs_offset = False
        return sequence + self._sequence_offset
