"""Quality of a pose as one number, for the field `quality` of ODOMETRY."""

from __future__ import annotations

import math

import numpy as np

from calm_edge.types import Float, PoseStatus

FAILED, UNKNOWN = -1, 0
# sigmas of position, rotation and log scale at which the quality is half of the maximum
HALF_SIGMA_M, HALF_SIGMA_RAD, HALF_SIGMA_SCALE = 0.05, math.radians(0.25), 0.05
_LAGGING_SHARE = 0.5


def quality(covariance: Float, scale_log_sigma: float, status: PoseStatus) -> int:
    """Return -1 (lost or without a metre), 0 (unknown), else the quality from 1 to 100.

    100 / (1 + (sigma_t / 5 cm)^2 + (sigma_r / 0.25 deg)^2 + (sigma_s / 5 %)^2).
    covariance: (6, 6) of (translation, rotation) given the scale, metres and rad. sigma_t, sigma_r:
    sigma of the translation and of the rotation in its most uncertain direction; sigma_s:
    scale_log_sigma. The result is halved while the estimator lags, as the pose then refers to an
    old sub-map; rounded, at least 1.
    """
    if not status.usable:
        return FAILED
    if not np.isfinite(covariance).all():
        return UNKNOWN
    translation = float(np.linalg.eigvalsh(covariance[:3, :3])[-1]) / HALF_SIGMA_M**2
    rotation = float(np.linalg.eigvalsh(covariance[3:, 3:])[-1]) / HALF_SIGMA_RAD**2
    share = 1.0 / (1.0 + translation + rotation + (scale_log_sigma / HALF_SIGMA_SCALE) ** 2)
    if status is PoseStatus.LAGGING:
        share *= _LAGGING_SHARE
    return max(1, round(100 * share))
