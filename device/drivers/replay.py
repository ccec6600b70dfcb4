"""Replay of recorded or generated frames as a camera, optionally with injected faults."""

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
    """Faults to inject. Times are ns after the replay's epoch; intervals [from, to).

    drop: probability that a frame is lost. freeze: interval without frames while connected.
    jitter_ns: standard deviation of the noise on the stamps. disconnect: interval in which the
    camera is unplugged.
    """

    drop: float = 0.0
    freeze: Interval | None = None
    jitter_ns: float = 0.0
    disconnect: Interval | None = None
    seed: int = 0


def _inside(interval: Interval | None, t_ns: int) -> bool:
    return interval is not None and interval[0] <= t_ns < interval[1]


class ReplayCamera:
    """A Camera that plays given frames.

    frames: of the spec's eye, in order of time; iterated lazily.
    paced: deliver each frame when it is due, its stamp shifted by origin_ns - epoch_ns. Not
    paced: deliver as fast as read() is called, with the original stamps.
    epoch_ns: the stamp at which the replay starts, by default the first frame's. origin_ns: the
    time of `clock` to which it is mapped, by default that of start(). Replays with equal
    epoch_ns and origin_ns are synchronous.
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
        """True once read() has reached the end of the frames."""
        return self._exhausted

    @property
    def settings(self) -> dict[str, int | float | str]:
        """Empty: a replay has no settings."""
        return {}

    @property
    def remarks(self) -> tuple[str, ...]:
        """Empty: a replay fulfils no requests."""
        return ()

    @property
    def connected(self) -> bool:
        """False in the disconnect interval."""
        if not (self._running and self._paced and self._origin_ns is not None):
            return self._running
        return not _inside(self._faults.disconnect, self._clock.now_ns() - self._origin_ns)

    def start(self) -> None:
        """Start the replay; the current time becomes origin_ns unless that was given."""
        if self._origin_ns is None:
            self._origin_ns = self._clock.now_ns()
        self._running = True

    def read(self, timeout_s: float) -> Frame | None:
        """Return the next frame once it is due; raises CameraError for the other eye's frame."""
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
        """Return the newest frame that is due; if not paced, the next one regardless of age."""
        if not self._paced:
            return self.read(0.0)
        while self.read(0.0) is not None:
            pass
        return self._stream.fresh(self._clock.now_ns(), max_age_ns) if self._running else None

    def stop(self) -> None:
        """End the replay; the remaining frames are not read."""
        self._running = False

    def stats(self) -> CameraStats:
        """Return the counters."""
        return self._stream.stats

    def _next(self) -> Frame | None:
        """Next frame that passes the injected faults, with its stamp shifted and jittered."""
        faults = self._faults
        for frame in self._frames:
            if frame.eye is not self.spec.eye:
                raise CameraError(
                    f"{self.spec.name}: got a frame of the {frame.eye.name.lower()} camera; "
                    "give each replay the frames of its own eye"
                )
            # draw both for every frame, so that one fault does not change the other's sequence
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
