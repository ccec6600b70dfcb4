"""Turns of two cameras on one car as `TurnMeter` gives them, without pictures."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d

from calm_edge.interchange.turns import Turns
from calm_edge.types import Float

STEP_S = 0.005
NOISE = 0.1 / 320


def smooth(rng: np.random.Generator, n: int, hz: float) -> Float:
    """Noise (n,) of unit variance below `hz`."""
    x = gaussian_filter1d(rng.standard_normal(n), 1 / (2 * np.pi * hz * STEP_S))
    return np.asarray(x / x.std(), np.float64)


def angles(seconds: float, rng: np.random.Generator) -> Float:
    """Yaw, pitch and roll (N, 3) [rad] every STEP_S: curves every 15 s, and a road with bumps."""
    n = int(seconds / STEP_S) + 1
    yaw, t = 0.005 * smooth(rng, n, 1.0), 0.0
    while t < seconds:
        t += rng.exponential(15)
        k = round(rng.uniform(2, 6) / STEP_S)
        first = min(int(t / STEP_S), n - k)
        bump = 1 - np.cos(2 * np.pi * np.arange(k) / k)
        yaw[first : first + k] += rng.uniform(-1.2, 1.2) / (k * STEP_S) * bump
    pitch = 0.02 * smooth(rng, n, 1.5) + 0.01 * smooth(rng, n, 4.0)
    rates = np.stack([yaw, pitch, 0.02 * smooth(rng, n, 1.2)], axis=1)
    return np.asarray(np.cumsum(rates, axis=0) * STEP_S, np.float64)


def seen(angle: Float, at_s: Float, own_s: Float, mixing: Float, rng: np.random.Generator) -> Turns:
    """What a camera measures with pictures at at_s (N,), stamped own_s (N,)."""
    grid = STEP_S * np.arange(len(angle))
    total = np.stack([np.interp(at_s, grid, column) for column in angle.T], axis=1) @ mixing.T
    step = np.diff(total, axis=0) + NOISE * rng.standard_normal((len(at_s) - 1, 3))
    # the parallax of the street, which the other camera sees otherwise
    parallax = gaussian_filter1d(rng.standard_normal(step.shape), 30, axis=0) * 1e-3
    sigma = np.full(len(step), NOISE)
    return Turns(own_s, step + parallax, np.zeros(len(step)), sigma)


def drive(
    seconds: float, seed: int, later_s: float = 3.7, ppm: float = 0.0, missing_s: float = 0.0
) -> tuple[Turns, Turns, Float]:
    """Turns of both cameras, and the assistant's true times on the primary's clock.

    ppm: by which its clock is slow. missing_s: left out of its stamps after half of the time.
    """
    rng = np.random.default_rng(seed)
    angle = angles(seconds, rng)
    t0 = np.arange(0, seconds, 1 / 29.97)
    t1 = np.arange(later_s, seconds - 1, 1 / 25)
    t1 = t1[rng.uniform(size=len(t1)) > 0.05]
    own = (t1 - t1[0]) * (1 - 1e-6 * ppm)
    own[len(own) // 2 :] -= missing_s
    mixing = np.diag([0.8, 0.8, 1.0]) + 0.1 * rng.standard_normal((3, 3))
    primary = seen(angle, t0, t0, np.diag([0.7, 0.7, 1.0]), rng)
    return primary, seen(angle, t1, own, mixing, rng), t1
