"""Replay of recorded or generated frames as a camera."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable, Iterator

from device.camera import CameraSpec, CameraStats
from device.clock import NS_PER_S, Clock
from device.errors import CameraError
from device.frame import Frame, Unusable
from device.seldom import Seldom
from device.stream import Stream

log = logging.getLogger(__name__)


class ReplayCamera:
    """A Camera that plays given frames, with their own stamps.

    frames: of the spec's eye, in order of time; iterated lazily. Unusable ones are left out,
    counted as corrupt and logged, at most one a minute. paced: deliver each frame when `clock`, in
    the time of the stamps, has reached its stamp; else as fast as read() is called.
    """

    def __init__(
        self,
        spec: CameraSpec,
        clock: Clock,
        *,
        frames: Iterable[Frame | Unusable],
        paced: bool = True,
    ) -> None:
        self.spec = spec
        self._clock = clock
        self._frames: Iterator[Frame | Unusable] = iter(frames)
        self._paced = paced
        self._stream = Stream()
        self._pending: Frame | None = None
        self._exhausted = False
        self._running = False
        self._warn = Seldom(log.warning)

    @property
    def exhausted(self) -> bool:
        """True once read() has reached the end of the frames."""
        return self._exhausted

    @property
    def settings(self) -> dict[str, int | float | str]:
        """Empty: a replay has no settings."""
        return {}

    @property
    def remarks(self) -> tuple[str, ...]:
        """Empty: nothing can be requested of a replay."""
        return ()

    @property
    def connected(self) -> bool:
        """True between start() and stop()."""
        return self._running

    def start(self) -> None:
        """Start the replay."""
        self._running = True

    def read(self, timeout_s: float) -> Frame | None:
        """Return the next frame once it is due; raises CameraError for a frame of the other eye."""
        if not self._running:
            return None
        limit_ns = self._clock.now_ns() + math.floor(timeout_s * NS_PER_S)
        if self._pending is None:
            self._pending = self._next_usable()
        frame = self._pending
        if frame is None:
            self._exhausted = True
            return None
        if frame.eye is not self.spec.eye:
            raise CameraError(
                f"{self.spec.name}: got a frame of the {frame.eye.name.lower()} camera; "
                "give each replay the frames of its own eye"
            )
        if self._paced:
            if frame.t_ns > limit_ns:
                self._clock.sleep_until_ns(limit_ns)
                return None
            self._clock.sleep_until_ns(frame.t_ns)
        self._pending = None
        return self._stream.admit(frame, self._clock.now_ns() if self._paced else None)

    def _next_usable(self) -> Frame | None:
        for frame in self._frames:
            if isinstance(frame, Frame):
                return frame
            self._stream.lose(frame.sequence)
            self._warn(frame.reason)
        return None

    def stop(self) -> None:
        """End the replay; the remaining frames are not read."""
        self._running = False

    def stats(self) -> CameraStats:
        """Return the counters."""
        return self._stream.stats
