"""Depth metrics: relative error, share within five percent, and AUSE of the confidence.

AUSE, area under the sparsification error curve: Ilg et al., "Uncertainty estimates and
multi-hypotheses networks for optical flow", 2018.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calm_edge.types import Float

CLOSE = 0.05
STEPS = 20


@dataclass(frozen=True, slots=True)
class DepthScore:
    """Depth metrics over M pixels.

    abs_rel: mean of |z - true| / true. close: share of pixels with this error below CLOSE. ause:
    area between the sparsification curves by confidence and by error, divided by abs_rel; 0 is
    best.
    """

    abs_rel: float
    close: float
    ause: float


def relative_error(z: Float, true_z: Float) -> Float:
    """Relative error (M,) of depth, |z - true| / true."""
    return np.asarray(np.abs(z - true_z) / true_z)


def score(error: Float, confidence: Float) -> DepthScore:
    """Compute the metrics from relative errors (M,), M >= 1, and confidences (M,)."""
    mean = float(error.mean())
    area = _sparsified(error, -confidence) - _sparsified(error, error)
    return DepthScore(mean, float((error <= CLOSE).mean()), area / max(mean, 1e-12))


def _sparsified(error: Float, worst_last: Float) -> float:
    """Mean error of the best share of pixels, averaged over STEPS shares (a sparsification curve).

    worst_last: sort key (M,), smaller is better.
    """
    kept = np.cumsum(error[np.argsort(worst_last, kind="stable")])
    n = np.maximum(1, np.round(np.arange(1, STEPS + 1) / STEPS * len(error)).astype(np.int64))
    return float((kept[n - 1] / n).mean())


def most_confident(known: NDArray[np.bool_], confidence: Float, count: int) -> NDArray[np.bool_]:
    """Mask (M,) of the `count` most confident pixels with depth, or of all if there are fewer.

    known: (M,) pixels with depth.
    """
    order = np.argsort(np.where(known, -confidence, np.inf), kind="stable")
    chosen = np.zeros(len(known), bool)
    chosen[order[:count]] = True
    return chosen & known
