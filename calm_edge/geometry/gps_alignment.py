"""Align a path to GPS fixes: rotation, position, delay of the fixes and scale, robustly.

A fix of time t shows the position at t - delay. Parameters are found by nonlinear least squares
with a Cauchy loss from a start that two fixes at a time vote for; then fixes beyond REFUSED_SIGMAS
are left out and the rest is fitted without that loss, from which the sigmas are. The path has z up
within TILT_SIGMA, which decides where the fixes do not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from calm_edge.geometry import se3

Float = NDArray[np.float64]
Flags = NDArray[np.bool_]

REFUSED_SIGMAS = 4.0
MIN_FIXES = 10
# the fixes must extend this many sigmas for a direction
MIN_EXTENT_SIGMAS = 10.0
# larger distances, as a share of the extent of the fixes, are no drift of the path
MAX_APART = 0.05
# a longer gap of the path is not interpolated [s]
MAX_GAP_S = 1.0
DELAY_SIGMA_S, TILT_SIGMA = 1.0, 0.1
_TRIALS = 300
# of the log of a scale that is given
_GIVEN = 1e-6


class GpsAlignmentError(ValueError):
    """The fixes do not determine an alignment; the text says why."""


@dataclass(frozen=True, slots=True)
class Alignment:
    """Result of `align`: enu = scale * R @ p + t, and the fixes were `delay_s` late.

    *_sigma: one standard deviation; tilt_sigma: of the vertical, about the axis that is shown worst
    [rad]; scale_log_sigma is 0 if the scale was given. used: (M,) fixes
    that were neither refused nor outside the path. inside: (M,) fixes within the path's time.
    residual_m: (M,) horizontal distances from the path, NaN outside of it.
    """

    R: Float
    t: Float
    scale: float
    delay_s: float
    delay_sigma_s: float
    scale_log_sigma: float
    tilt_sigma: float
    used: Flags
    inside: Flags
    residual_m: Float

    def apply(self, T: Float) -> Float:
        """Poses (N, 4, 4) in the frame of the path -> in ENU."""
        return se3.compose(self.R @ T[:, :3, :3], self.scale * T[:, :3, 3] @ self.R.T + self.t)


def align(
    path_s: Float, path: Float, fix_s: Float, fixes: Float, sigma_m: Float, *, free_scale: bool
) -> Alignment:
    """Align a path to fixes. Raises GpsAlignmentError.

    path_s (N,) increasing, path (N, 3) with z up; fix_s (M,), fixes (M, 3) ENU [m]; sigma_m (M, 3).
    free_scale: the path's lengths are of unknown scale, otherwise metres.
    """
    inside = _inside(path_s, fix_s)
    if inside.sum() < MIN_FIXES:
        raise GpsAlignmentError(f"only {inside.sum()} fixes during the path, {MIN_FIXES} needed")
    t_s, seen, sigma = fix_s[inside], fixes[inside], sigma_m[inside]
    extent = float(np.linalg.norm(np.ptp(seen[:, :2], axis=0)))
    if extent < MIN_EXTENT_SIGMAS * float(np.median(sigma[:, :2])):
        raise GpsAlignmentError(f"the fixes extend over {extent:.1f} m, too little for a direction")
    at_fix = _interpolated(path_s, path, t_s)
    start = _vote(at_fix, seen, sigma, free_scale)
    # prior sigmas: rotation vector about the start, delay, log scale; the position is free
    scale_sigma = 10.0 if free_scale else _GIVEN
    prior = np.array([TILT_SIGMA, TILT_SIGMA, np.inf, DELAY_SIGMA_S, scale_sigma])
    R_0, scale_0 = se3.so3_exp(np.array([0.0, 0.0, start[0]])), start[1]

    def residuals(x: Float, keep: Flags) -> Float:
        p = _interpolated(path_s, path, t_s[keep] - x[6])
        off = scale_0 * np.exp(x[7]) * p @ (se3.so3_exp(x[:3]) @ R_0).T + x[3:6] - seen[keep]
        return np.concatenate([(off / sigma[keep]).ravel(), x[[0, 1, 2, 6, 7]] / prior])

    x = np.concatenate([np.zeros(3), start[2:5], np.zeros(2)])
    every = np.ones(len(seen), bool)
    scales = np.array([0.01, 0.01, 0.01, 1, 1, 1, 0.1, 0.01])
    for spread in (30.0, 1.0):
        x = least_squares(
            residuals, x, loss="cauchy", f_scale=spread, x_scale=scales, args=(every,)
        ).x
    # drift of the path counts as noise: fixes are judged against the spread that most of them have
    off = residuals(x, every)[: seen.size].reshape(-1, 3)[:, :2]
    spread = max(1.0, float(np.median(np.hypot(*off.T))) / 1.177)
    keep = np.hypot(*off.T) <= REFUSED_SIGMAS * spread
    metres = residuals(x, every)[: seen.size].reshape(-1, 3) * sigma
    apart = float(np.median(np.hypot(metres[:, 0], metres[:, 1])))
    if keep.sum() < MIN_FIXES or apart > MAX_APART * extent:
        raise GpsAlignmentError(
            f"the fixes do not agree with the path: {apart:.0f} m apart (median) of {extent:.0f}"
        )
    fit = least_squares(residuals, x, x_scale=scales, args=(keep,))
    x = fit.x
    chi2 = float((fit.fun[: 3 * keep.sum()] ** 2).sum()) / max(1, 3 * int(keep.sum()) - 8)
    jacobian: Float = np.array(fit.jac, dtype=np.float64)
    covariance = np.linalg.inv(jacobian.T @ jacobian) * max(1.0, chi2)
    used = np.zeros(len(fix_s), bool)
    used[np.flatnonzero(inside)[keep]] = True
    residual_m = np.full(len(fix_s), np.nan)
    metres = residuals(x, every)[: seen.size].reshape(-1, 3) * sigma
    residual_m[inside] = np.hypot(metres[:, 0], metres[:, 1])
    return Alignment(
        se3.so3_exp(x[:3]) @ R_0,
        x[3:6],
        float(scale_0 * np.exp(x[7])),
        float(x[6]),
        float(np.sqrt(covariance[6, 6])),
        float(np.sqrt(covariance[7, 7])) if free_scale else 0.0,
        float(np.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[-1])),
        used,
        inside,
        residual_m,
    )


def _inside(path_s: Float, fix_s: Float) -> Flags:
    """Whether each fix lies between two poses that are at most MAX_GAP_S apart."""
    after = np.searchsorted(path_s, fix_s)
    between = (after > 0) & (after < len(path_s))
    after = np.clip(after, 1, len(path_s) - 1)
    return np.asarray(between & (path_s[after] - path_s[after - 1] <= MAX_GAP_S))


def _interpolated(path_s: Float, path: Float, t_s: Float) -> Float:
    return np.stack([np.interp(t_s, path_s, path[:, k]) for k in range(3)], axis=1)


def _vote(p: Float, seen: Float, sigma: Float, free_scale: bool) -> Float:
    """Yaw, scale and position (5,) that most fixes agree with, of those of random pairs."""
    rng = np.random.default_rng(0)
    flat, target = p[:, 0] + 1j * p[:, 1], seen[:, 0] + 1j * seen[:, 1]
    best, best_cost = np.array([0.0, 1.0, 0.0, 0.0, 0.0]), np.inf
    spread = 5 * float(np.median(sigma[:, :2]))
    for _ in range(_TRIALS):
        i, j = rng.choice(len(p), 2, replace=False)
        if abs(target[i] - target[j]) < spread or abs(flat[i] - flat[j]) < 1e-9:
            continue
        turn = (target[j] - target[i]) / (flat[j] - flat[i])
        turn = turn if free_scale else turn / abs(turn)
        away = target - turn * flat
        centre = np.median(away.real) + 1j * np.median(away.imag)
        cost = float(np.minimum(np.abs(away - centre) / spread, 4.0).sum())
        if cost < best_cost:
            up = float(np.median(seen[:, 2] - abs(turn) * p[:, 2]))
            best_cost = cost
            best = np.array([np.angle(turn), abs(turn), centre.real, centre.imag, up])
    if not np.isfinite(best_cost):
        raise GpsAlignmentError("the path does not move between the fixes")
    return best
