"""Turn rates on a uniform grid of time, from the turns between frames at any stamps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d, uniform_filter1d

from calm_edge.interchange.turns import Turns
from calm_edge.types import Float

# shorter means of the rate are not used: a gap of this length is filled, a slower change is drift
HIGH_PASS_S = 20.0


@dataclass(frozen=True, slots=True)
class Rates:
    """Turn rates of one camera.

    start_s: time of the first sample. dt_s: interval. frame_s: median interval of the frames. rate:
    (N, 3) right, down [widths/s], roll [rad/s]; 0 where unknown. known: (N,) bool.
    """

    start_s: float
    dt_s: float
    frame_s: float
    rate: Float
    known: NDArray[np.bool_]

    @property
    def t_s(self) -> Float:
        """Times (N,) of the samples."""
        return np.asarray(self.start_s + self.dt_s * np.arange(len(self.rate)), np.float64)

    @property
    def end_s(self) -> float:
        """Time of the last sample."""
        return self.start_s + self.dt_s * (len(self.rate) - 1)


def rates(turns: Turns, dt_s: float, smooth_s: float) -> Rates:
    """Sample the turn rates every dt_s, smoothed by a Gaussian of sigma smooth_s.

    The rate is the derivative of the turn summed over frames, which is known at the frames' own
    stamps whatever their intervals; so two cameras of different frame rates are comparable.
    """
    t, good = turns.t_s, np.isfinite(turns.sigma)
    total = np.vstack([np.zeros(3), np.cumsum(np.where(good[:, None], turns.step, 0.0), axis=0)])
    n = max(2, int((t[-1] - t[0]) / dt_s))
    edges = t[0] + dt_s * np.arange(n + 1)
    rate = np.diff(CubicSpline(t, total, axis=0)(edges), axis=0) / dt_s
    centres = edges[:-1] + dt_s / 2
    interval = np.clip(np.searchsorted(t, centres) - 1, 0, len(good) - 1)
    known = good[interval]
    if smooth_s > 0:
        weight = gaussian_filter1d(known.astype(float), smooth_s / dt_s, mode="constant")
        rate = gaussian_filter1d(rate, smooth_s / dt_s, axis=0, mode="constant")
        rate /= np.maximum(weight, 1e-9)[:, None]
        known = known & (weight > 0.5)
    rate = np.where(known[:, None], rate, 0.0)
    frame_s = float(np.median(np.diff(t)))
    return Rates(float(centres[0]), dt_s, frame_s, _without_slow_part(rate, known, dt_s), known)


def _without_slow_part(rate: Float, known: NDArray[np.bool_], dt_s: float) -> Float:
    """Subtract the moving mean: a curve's parallax differs between the cameras, its onset not."""
    size = min(len(rate), max(3, round(HIGH_PASS_S / dt_s)))
    share = uniform_filter1d(known.astype(float), size, mode="constant")
    mean = uniform_filter1d(rate, size, axis=0, mode="constant")
    slow = mean / np.maximum(share, 1e-9)[:, None]
    return np.where(known[:, None], rate - slow, 0.0)
