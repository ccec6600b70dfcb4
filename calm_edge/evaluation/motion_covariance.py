"""Covariance of the motion between two live poses."""

from __future__ import annotations

import numpy as np

from calm_edge.geometry import se3
from calm_edge.types import Float, PoseSample


def motion_covariance(first: PoseSample, then: PoseSample, with_scale: bool = True) -> Float:
    """Covariance (6, 6) of the motion from one live pose to a later one of the same epoch.

    (translation, rotation) in axes of the later pose. Errors relative to the tracked points are
    independent, so is the drift between the poses; those of scale and focal length are common to
    both poses. A scale that is unknown makes the translation's part NaN; with_scale: whether to add
    its error.
    """
    T_then_first = se3.inverse(then.T_w_c) @ first.T_w_c
    to_then = se3.adjoint(T_then_first)
    before = first.covariance - first.drift
    total = then.covariance + then.drift + to_then @ before @ to_then.T
    bent = then.focal_offset - to_then @ first.focal_offset
    total = total + np.outer(bent, bent)
    if with_scale:
        sigma, step = then.scale_log_sigma, T_then_first[:3, 3]
        total[:3, :3] += sigma**2 * np.outer(step, step) if np.isfinite(sigma) else np.nan
    return np.asarray(total)
