"""Plays any frames as if a camera took them now: recordings, demos, tests, with faults to order."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from device.camera import CameraSpec, CameraStats
from device.clock import NS_PER_S, Clock
from device.errors import CameraError
from device.frame import Frame
from device.stream import Stream

Interval = tuple[int, int]


@dataclass(frozen=True, slots=True)
class ReplayFaults:
    """What goes wrong during a replay. Times are ns after the epoch; intervals [from, to).

    drop: probability that a frame is lost. freeze: no frames, the camera stays connected.
    jitter_ns: one sigma of noise on the stamps. disconnect: the camera is gone, then back.
    """

    drop: float = 0.0
    freeze: Interval | None = None
    jitter_ns: float = 0.0
    disconnect: Interval | None = None
    seed: int = 0


def _inside(interval: Interval | None, t_ns: int) -> bool:
    return interval is not None and interval[0] <= t_ns < interval[1]


class ReplayCamera:
    """Frames on a clock.

    frames: of the spec's eye, in order of time; read one by one as they are needed.
    paced: each is handed over when it is due, its stamp moved so that epoch_ns, a stamp, falls
    on origin_ns, a time of the clock. Not paced: as fast as asked, stamps as they are.
    epoch_ns: the start of the timeline, by default the first frame. origin_ns: by default the
    moment of start(). Two replays that are given the same two share one timeline.
    """

    def __init__(
        self,
        spec: CameraSpec,
        clock: Clock,
        *,
        frames: Iterable[Frame],
        epoch_ns: int | None = None,
        origin_ns: int | None = None,
        paced: bool = True,
        faults: ReplayFaults | None = None,
    ) -> None:
        self.spec = spec
        self._clock = clock
        self._frames: Iterator[Frame] = iter(frames)
        self._epoch_ns = epoch_ns
        self._origin_ns = origin_ns
        self._paced = paced
        self._faults = faults or ReplayFaults()
        self._random = np.random.default_rng((self._faults.seed, int(spec.eye)))
        self._stream = Stream()
        self._pending: Frame | None = None
        self._last_t_ns: int | None = None
        self._cut_off = False
        self._exhausted = False
        self._running = False

    @property
    def exhausted(self) -> bool:
        """True once a read has found the end."""
        return self._exhausted

    @property
    def settings(self) -> dict[str, int | float | str]:
        """None: what was recorded is as it is."""
        return {}

    @property
    def remarks(self) -> tuple[str, ...]:
        """None: nothing was asked of it."""
        return ()

    @property
    def connected(self) -> bool:
        """False inside the disconnect interval."""
        if not (self._running and self._paced and self._origin_ns is not None):
            return self._running
        return not _inside(self._faults.disconnect, self._clock.now_ns() - self._origin_ns)

    def start(self) -> None:
        """The origin of the timeline, unless it was given, is now."""
        if self._origin_ns is None:
            self._origin_ns = self._clock.now_ns()
        self._running = True

    def read(self, timeout_s: float) -> Frame | None:
        """The next frame, waiting for it to be due; raises CameraError for another eye's frame."""
        if not self._running:
            return None
        limit_ns = self._clock.now_ns() + math.floor(timeout_s * NS_PER_S)
        if self._pending is None:
            self._pending = self._next()
        frame = self._pending
        if frame is None:
            self._exhausted = True
            return None
        if self._paced:
            if frame.t_ns > limit_ns:
                self._clock.sleep_until_ns(limit_ns)
                return None
            self._clock.sleep_until_ns(frame.t_ns)
        self._pending = None
        if self._cut_off:
            self._cut_off = False
            self._stream.count("reconnects")
        return self._stream.admit(frame, self._clock.now_ns() if self._paced else None)

    def latest(self, max_age_ns: int) -> Frame | None:
        """The newest frame that is due. Not paced: the next one, whatever its age."""
        if not self._paced:
            return self.read(0.0)
        while self.read(0.0) is not None:
            pass
        return self._stream.fresh(self._clock.now_ns(), max_age_ns) if self._running else None

    def stop(self) -> None:
        """The frames not yet read stay unread."""
        self._running = False

    def stats(self) -> CameraStats:
        """The counts so far."""
        return self._stream.stats

    def _next(self) -> Frame | None:
        """The next frame the faults let through, on the timeline it is handed over in."""
        faults = self._faults
        for frame in self._frames:
            if frame.eye is not self.spec.eye:
                raise CameraError(
                    f"{self.spec.name}: was given a frame of the {frame.eye.name.lower()} camera"
                )
            # both drawn for every frame, so that one fault does not reshuffle the other
            lost = self._random.random() < faults.drop
            jitter_ns = round(self._random.normal() * faults.jitter_ns)
            if self._epoch_ns is None:
                self._epoch_ns = frame.t_ns
            elapsed_ns = frame.t_ns - self._epoch_ns
            if _inside(faults.disconnect, elapsed_ns):
                self._cut_off = True
                continue
            if lost or _inside(faults.freeze, elapsed_ns):
                continue
            t_ns = frame.t_ns + jitter_ns
            if self._paced and self._origin_ns is not None:
                t_ns += self._origin_ns - self._epoch_ns
            if faults.jitter_ns and self._last_t_ns is not None:
                t_ns = max(t_ns, self._last_t_ns + 1)
            self._last_t_ns = t_ns
            return dataclasses.replace(frame, t_ns=t_ns)
        return None
