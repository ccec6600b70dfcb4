"""Exposure times and stamps of two cameras on one path."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.scripted import Exposures
from calm_edge.types import Int
from device.frame import Eye


@dataclass(frozen=True, slots=True)
class Streams:
    """Timing of the two picture streams, with errors of their stamps.

    alternate: odd frames to one eye and even ones to the other, the paper's asynchronous mode.
    halved: every other frame to both eyes, synchronous at the same rate. offset_s: delay of the
    assistant's exposures. late_s: delay of stamps after the exposure, per eye. jitter_s: sigma of
    the noise of all stamps. drift_ppm: rate error of the assistant's clock. drop_share: share of
    frames dropped, per eye.
    """

    alternate: bool = False
    halved: bool = False
    offset_s: float = 0.0
    late_s: tuple[float, float] = (0.0, 0.0)
    jitter_s: float = 0.0
    drift_ppm: float = 0.0
    drop_share: float = 0.0

    def exposures(self, t_ns: Int, seed: int) -> tuple[Exposures, Exposures]:
        """Exposure times and stamps of both eyes on a path sampled at t_ns (N,)."""
        rng = np.random.default_rng(seed)
        first = t_ns[::2] if self.alternate or self.halved else t_ns
        second = t_ns[1::2] if self.alternate else first
        return self._eye(Eye.PRIMARY, first, rng), self._eye(Eye.ASSISTANT, second, rng)

    def _eye(self, eye: Eye, t_ns: Int, rng: np.random.Generator) -> Exposures:
        kept = t_ns[rng.uniform(size=len(t_ns)) >= self.drop_share]
        off_ns = np.full(len(kept), self.late_s[eye] * 1e9)
        off_ns += self.jitter_s * 1e9 * rng.standard_normal(len(kept))
        if eye == Eye.ASSISTANT:
            off_ns += self.drift_ppm * 1e-6 * (kept - t_ns[0])
            kept = kept + round(self.offset_s * 1e9)
            kept = kept[kept <= t_ns[-1]]
            off_ns = off_ns[: len(kept)]
        stamps = kept + np.round(off_ns).astype(np.int64)
        # keep the stamps increasing, as a driver delivers frames in order
        stamps = np.maximum.accumulate(stamps - np.arange(len(kept))) + np.arange(len(kept))
        return Exposures(stamp_ns=stamps, t_ns=kept)
