"""Points from their pixels in views of known pose."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
Int = NDArray[np.int64]


def triangulate(
    T_c_s: Float, view: Int, point: Int, rays: Float, n_points: int, edge: Float | None = None
) -> Float:
    """Linear triangulation of M = n_points points: (M, 4) unit homogeneous, NaN if not seen twice.

    T_c_s: (C, 4, 4) of C views. view, point: (O,) of each observation. rays: (O, 2) on z = 1.
    edge: (O, 2) directions along which the rays count less, times the root of the share left out.
    Signed so that z > 0 in the views. Hartley and Zisserman, "Multiple View Geometry", 2004, 12.2.
    """
    P = T_c_s[view][:, :3]
    # each ray gives two rows of A X = 0; the 4 x 4 A^T A of every point is built by summation
    rows = np.stack([rays[:, 0, None] * P[:, 2] - P[:, 0], rays[:, 1, None] * P[:, 2] - P[:, 1]], 1)
    if edge is not None:
        rows -= edge[:, :, None] * (edge[:, None] @ rows)
    outer = rows.transpose(0, 2, 1) @ rows
    A = np.zeros((n_points, 4, 4))
    np.add.at(A, point, outer)
    X = np.linalg.eigh(A)[1][:, :, 0]
    z = np.bincount(point, (P[:, 2] * X[point]).sum(1), n_points)
    X *= np.where(z < 0, -1.0, 1.0)[:, None]
    X[np.bincount(point, minlength=n_points) < 2] = np.nan
    return np.asarray(X)
