"""Jitter of a window's stamps: their deviation from a constant frame rate."""

from __future__ import annotations

import numpy as np

from calm_edge.types import Float

MIN_FRAMES = 6
# If the sigma of the jitter exceeds this share of the period, there is no constant frame rate.
LARGEST_SHARE = 0.1
# Periods tried, as multiples of the shortest gap: keyframes may all be two or three frames apart.
TRIED = np.geomspace(0.3, 1.25, 120)
ITERATIONS = 4


def jitter(t: Float) -> Float | None:
    """Residuals (N,) s of increasing stamps t (N,) s from a constant frame rate; None without one.

    Period and phase are fitted; frames may be missing. Where several periods explain the gaps, any
    of them is used.
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
