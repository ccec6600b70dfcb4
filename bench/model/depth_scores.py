"""How good a depth is: relative error, share within five percent, and what its confidence knows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calm_edge.types import Float

CLOSE = 0.05
STEPS = 20


@dataclass(frozen=True, slots=True)
class DepthScore:
    """Of the pixels scored, M in number. abs_rel: mean of |z - true| / true. close: share within
    CLOSE. ause: area between the sparsification by confidence and by the error itself, as a part
    of abs_rel; 0 is perfect."""

    abs_rel: float
    close: float
    ause: float


def relative_error(z: Float, true_z: Float) -> Float:
    """|z - true| / true (M,)."""
    return np.asarray(np.abs(z - true_z) / true_z)


def score(error: Float, confidence: Float) -> DepthScore:
    """Of relative errors (M,), M >= 1, and confidences (M,)."""
    mean = float(error.mean())
    area = _sparsified(error, -confidence) - _sparsified(error, error)
    return DepthScore(mean, float((error <= CLOSE).mean()), area / max(mean, 1e-12))


def _sparsified(error: Float, worst_last: Float) -> float:
    """Mean over STEPS shares of the mean error of what is left when the worst are dropped."""
    kept = np.cumsum(error[np.argsort(worst_last, kind="stable")])
    n = np.maximum(1, np.round(np.arange(1, STEPS + 1) / STEPS * len(error)).astype(np.int64))
    return float((kept[n - 1] / n).mean())


def most_confident(known: NDArray[np.bool_], confidence: Float, count: int) -> NDArray[np.bool_]:
    """(M,) the `count` most confident of the known ones; all of these where they are fewer."""
    order = np.argsort(np.where(known, -confidence, np.inf), kind="stable")
    chosen = np.zeros(len(known), bool)
    chosen[order[:count]] = True
    return chosen & known
