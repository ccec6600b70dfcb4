"""Conversion of kits from version 0.1.0: one radial term an eye, k1, and no readout time.

The 15 entries of its kit vector are those of kit/layout.py without the newer terms and the families
of the lenses, which were perspective.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from calm_edge.kit import layout

SIZE = 15
_NEW = np.r_[layout.DISTORTION[:, 1], layout.READOUT, layout.FAMILY]
_KEPT = np.delete(np.arange(layout.SIZE), _NEW)


def converted(array: NDArray[Any]) -> NDArray[Any]:
    """Insert zeros for the new terms in every axis of SIZE entries: nothing is known of them.

    array: a kit (SIZE,), an information matrix (SIZE, SIZE), or derivatives by a kit (n, SIZE).
    """
    for axis, length in enumerate(array.shape):
        if length == SIZE:
            shape = list(array.shape)
            shape[axis] = layout.SIZE
            wider = np.zeros(shape, array.dtype)
            np.moveaxis(wider, axis, 0)[_KEPT] = np.moveaxis(array, axis, 0)
            array = wider
    return array
