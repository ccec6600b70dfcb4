"""How far the stamps of a window are from the beat of a camera that runs at a fixed rate."""

from __future__ import annotations

import numpy as np

from calm_edge.types import Float

MIN_FRAMES = 6
# Above this share of the period, one sigma, there is no beat to speak of.
LARGEST_SHARE = 0.1
# Periods tried, as multiples of the shortest gap: keyframes may all lie two or three frames apart.
TRIED = np.geomspace(0.3, 1.25, 120)
ITERATIONS = 4


def off_beat(t: Float) -> Float | None:
    """Stamps t (N,) s, growing, less the nearest even beat (N,) s; None where they have none.

    Frames may be missing. Where several rates explain the gaps the slowest does best.
    """
    gaps = np.diff(t)
    if len(t) < MIN_FRAMES or gaps.min() <= 0:
        return None
    periods = gaps.min() * TRIED
    period = float(periods[np.cos(2 * np.pi * gaps / periods[:, None]).mean(1).argmax()])
    residual = t - t[0]
    for _ in range(ITERATIONS):
        count = np.r_[0.0, np.cumsum(np.maximum(np.round(gaps / period), 1))]
        line = np.stack([np.ones_like(count), count], 1)
        start, period = np.linalg.lstsq(line, t, rcond=None)[0].tolist()
        residual = t - start - period * count
    spread = np.sqrt(residual @ residual / (len(t) - 2))
    return residual if spread < LARGEST_SHARE * period else None
