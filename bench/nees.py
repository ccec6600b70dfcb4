"""Whether claimed covariances are honest: the normalised estimation error squared.

Bar-Shalom, Li, Kirubarajan, "Estimation with applications to tracking and navigation", 2001,
5.4: an honest estimate's average over independent runs lies in a chi-square band.
"""

from __future__ import annotations

import numpy as np
from scipy import stats

from calm_edge.geometry import se3
from calm_edge.types import Float


def pose_nees(T: Float, T_truth: Float, covariance: Float) -> Float:
    """(M,) of poses (M, 4, 4) with covariances (M, 6, 6) of (translation, rotation).

    Both against the same origin and in the same unit; covariances in each pose's own axes.
    """
    error = se3.log(se3.inverse(T_truth) @ T)
    return _normalised(error, covariance)


def position_nees(T: Float, T_truth: Float, covariance: Float) -> Float:
    """(M,) as `pose_nees` of the positions alone."""
    axes = np.swapaxes(T_truth[:, :3, :3], -1, -2)
    error = (axes @ (T - T_truth)[:, :3, 3, None])[..., 0]
    return _normalised(error, covariance[:, :3, :3])


def honest_band(n: int, dof: int, confidence: float = 0.95) -> tuple[float, float]:
    """Where the average of n independent values, divided by dof, lies with that confidence.

    dof: 6 of poses, 3 of positions. Above it a covariance claims too much, below too little.
    """
    tail = (1 - confidence) / 2
    quantiles = stats.chi2(n * dof).ppf
    return float(quantiles(tail)) / (n * dof), float(quantiles(1 - tail)) / (n * dof)


def _normalised(error: Float, covariance: Float) -> Float:
    solved = np.linalg.solve(covariance, error[..., None])[..., 0]
    return np.asarray((error * solved).sum(-1))
