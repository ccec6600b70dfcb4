"""Normalised estimation error squared (NEES): whether claimed covariances match the errors.

Bar-Shalom, Li, Kirubarajan, "Estimation with applications to tracking and navigation", 2001,
5.4: for a consistent estimate the average over independent runs lies in a chi-square band.
"""

from __future__ import annotations

import numpy as np
from scipy import stats

from calm_edge.geometry import se3
from calm_edge.types import Float


def pose_nees(T: Float, T_truth: Float, covariance: Float) -> Float:
    """NEES (M,) of poses (M, 4, 4) with covariances (M, 6, 6) of (translation, rotation).

    Both relative to the same origin, in the same unit; covariances in each pose's own axes.
    """
    error = se3.log(se3.inverse(T_truth) @ T)
    solved = np.linalg.solve(covariance, error[..., None])[..., 0]
    return np.asarray((error * solved).sum(-1))


def consistent_band(n: int, confidence: float = 0.95) -> tuple[float, float]:
    """Interval of the mean of n independent pose NEES over 6, of that confidence.

    Above it the covariances are too small, below it too large.
    """
    tail, dof = (1 - confidence) / 2, 6 * n
    low, high = stats.chi2(dof).ppf([tail, 1 - tail]) / dof
    return float(low), float(high)
