"""One number for how good a pose is, as ODOMETRY has it."""

from __future__ import annotations

import math

import numpy as np

from calm_edge.types import Float, PoseStatus

FAILED, UNKNOWN = -1, 0
# a pose as uncertain as this is worth half of a perfect one
HALF_SIGMA_M, HALF_SIGMA_RAD = 0.05, math.radians(0.25)
_LAGGING_SHARE = 0.5


def quality(covariance: Float, status: PoseStatus) -> int:
    """-1 failed, 0 unknown, else 1 to 100: 100 / (1 + (sigma_t / 5 cm)^2 + (sigma_r / 0.25 deg)^2).

    covariance: (6, 6) of (translation, rotation), metres and rad; each sigma is that of its worst
    direction. Half of that while the estimator lags, for the map ahead is then growing old.
    """
    if status is PoseStatus.LOST:
        return FAILED
    if not np.isfinite(covariance).all():
        return UNKNOWN
    translation = float(np.linalg.eigvalsh(covariance[:3, :3])[-1]) / HALF_SIGMA_M**2
    rotation = float(np.linalg.eigvalsh(covariance[3:, 3:])[-1]) / HALF_SIGMA_RAD**2
    share = 1.0 / (1.0 + translation + rotation)
    if status is PoseStatus.LAGGING:
        share *= _LAGGING_SHARE
    return max(1, round(100 * share))
