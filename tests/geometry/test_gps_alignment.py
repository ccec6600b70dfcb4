"""Alignment to simulated fixes with noise, outliers, gaps and a delay."""

from __future__ import annotations

import numpy as np
import pytest

from calm_edge.geometry import se3
from calm_edge.geometry.gps_alignment import Float, GpsAlignmentError, align

R = se3.so3_exp(np.array([0.03, -0.02, 0.0])) @ se3.so3_exp(np.array([0.0, 0.0, 2.2]))
T = np.array([120.0, -45.0, 310.0])
DELAY_S, NOISE_M = 0.3, 1.5


def drive(duration_s: float = 120.0) -> tuple[Float, Float]:
    """Path of a car through bends at 5 to 15 m/s: times (N,) and positions (N, 3), z up."""
    t = np.arange(0, duration_s, 0.1)
    speed = 10 + 5 * np.sin(0.3 * t)
    heading = 0.8 * np.sin(0.1 * t) + 0.015 * t
    step = speed[:, None] * np.stack([np.cos(heading), np.sin(heading), 0.02 * np.sin(t)], 1)
    return t, np.cumsum(0.1 * step, axis=0)


def simulated(seed: int, scale: float = 1.0) -> tuple[Float, Float, Float, Float]:
    """Fixes at 5 Hz (times, ENU, sigmas) with two tunnels and a tenth of outliers; and which."""
    rng = np.random.default_rng(seed)
    t, p = drive()
    fix_s = np.arange(2, 118, 0.2)
    fix_s = fix_s[~(((fix_s > 30) & (fix_s < 45)) | ((fix_s > 80) & (fix_s < 88)))]
    at = np.stack([np.interp(fix_s - DELAY_S, t, p[:, k]) for k in range(3)], axis=1)
    fixes = scale * at @ R.T + T + rng.normal(0, NOISE_M, at.shape) * [1, 1, 2]
    wrong = rng.random(len(fixes)) < 0.1
    fixes[wrong, :2] += rng.normal(0, 40, (int(wrong.sum()), 2))
    sigma = np.tile(NOISE_M * np.array([1.0, 1, 2]), (len(fixes), 1))
    return fix_s, fixes, sigma, wrong


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("free", "scale"), [(False, 1.0), (True, 0.55)])
def test_delay_scale_and_position_are_found_among_outliers(
    seed: int, free: bool, scale: float
) -> None:
    t, p = drive()
    fix_s, fixes, sigma, wrong = simulated(seed, scale)
    found = align(t, p, fix_s, fixes, sigma, free_scale=free)
    assert abs(found.delay_s - DELAY_S) < max(0.03, 3 * found.delay_sigma_s)
    assert 0 < found.delay_sigma_s < 0.03
    assert abs(np.log(found.scale / scale)) <= 4 * found.scale_log_sigma + 1e-7
    assert found.scale_log_sigma < 0.002
    aligned = found.scale * p @ found.R.T + found.t
    truth = scale * p @ R.T + T
    assert np.hypot(*(aligned - truth)[:, :2].T).max() < 1.0
    assert np.abs((aligned - truth)[:, 2]).max() < 3.0
    assert not found.used[found.residual_m > 15].any()
    assert found.used[~wrong].mean() > 0.98


def test_a_wrong_metre_shows_in_a_free_scale() -> None:
    t, p = drive()
    fix_s, fixes, sigma, _ = simulated(0, 1.08)
    free = align(t, p, fix_s, fixes, sigma, free_scale=True)
    assert np.log(free.scale) / free.scale_log_sigma > 10
    given = align(t, p, fix_s, fixes, sigma, free_scale=False)
    assert abs(given.scale - 1) < 1e-4


def test_fixes_in_a_gap_of_the_path_and_outside_are_not_used() -> None:
    t, p = drive()
    fix_s, fixes, sigma, _ = simulated(1)
    cut = (t < 100) & ~((t > 55) & (t < 60))
    found = align(t[cut], p[cut], fix_s, fixes, sigma, free_scale=False)
    outside = (fix_s > 100) | ((fix_s > 55.1) & (fix_s < 59.9))
    assert not found.inside[outside].any() and np.isnan(found.residual_m[outside]).all()
    assert abs(found.delay_s - DELAY_S) < 0.05


def test_what_the_fixes_do_not_determine_is_refused() -> None:
    t, p = drive()
    fix_s, fixes, sigma, _ = simulated(2)
    with pytest.raises(GpsAlignmentError, match="only 5 fixes"):
        align(t, p, fix_s[:5], fixes[:5], sigma[:5], free_scale=False)
    still = np.tile(fixes[:1], (40, 1))
    with pytest.raises(GpsAlignmentError, match="too little for a direction"):
        align(t, p, fix_s[:40], still, sigma[:40], free_scale=False)
    noise = np.random.default_rng(0).uniform(-900, 900, fixes.shape)
    with pytest.raises(GpsAlignmentError, match="do not agree with the path"):
        align(t, p, fix_s, noise, 0.2 * sigma, free_scale=False)
