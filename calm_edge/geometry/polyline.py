"""Paths as polylines."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]


def path_length(p: Float) -> float:
    """Length of the polyline p (N, 3), in the unit of p."""
    return float(np.linalg.norm(np.diff(p, axis=0), axis=1).sum())
