"""Image edges, along which a match may slide: the aperture problem.

Around a corner the picture changes in all directions; on a lane marking, a kerb or a crash barrier
only across the edge. There a match is as exact as any across the edge and may be off by tens of
pixels along it, which no comparison of the pictures shows. The structure tensor does (Foerstner and
Guelch, "A Fast Operator for Detection and Precise Location of Distinct Points, Corners and Centres
of Circular Features", ISPRS 1987): its eigenvalues are the information in both directions.
"""

from __future__ import annotations

import cv2
import numpy as np

from calm_edge.geometry.flow import Gray
from calm_edge.types import Float32

RADIUS_PX = 8
# sigma of the Gaussian weights of the window, as a share of its radius
WINDOW_SHARE = 0.5
# Square root of the ratio of the eigenvalues. Measured errors along the edge are proportional to
# its inverse; below this value to its inverse square.
SLIPPERY = 0.2
# largest ratio of the sigma along an edge to that across it
MOST = 100.0

_AXIS = np.arange(-RADIUS_PX, RADIUS_PX + 1)
_G = np.exp(-0.5 * (_AXIS / (WINDOW_SHARE * RADIUS_PX)) ** 2)
_WEIGHT = np.asarray(np.outer(_G, _G).ravel(), np.float32)


def edges(picture: Gray, uv: Float32) -> Float32:
    """Edges (N, 2) at points uv (N, 2) px of a picture, as `problem.Measurements.edge`.

    The unit direction of the edge, times the root of 1 - sigma across / sigma along it: 0 for a
    corner, nearly 1 on a straight edge.
    """
    if len(uv) == 0:
        return np.zeros((0, 2), np.float32)
    padded = np.pad(picture, RADIUS_PX, mode="edge")
    height, width = picture.shape
    at = np.clip(np.round(uv).astype(np.int64), 0, [width - 1, height - 1]) + RADIUS_PX
    rows = (at[:, 1:] + _AXIS)[:, :, None]
    columns = (at[:, :1] + _AXIS)[:, None]
    slopes = [cv2.Sobel(padded, cv2.CV_16S, *order) for order in ((1, 0), (0, 1))]
    x, y = (s[rows, columns].reshape(len(uv), -1).astype(np.float32) for s in slopes)
    xx, xy, yy = (x * x) @ _WEIGHT, (x * y) @ _WEIGHT, (y * y) @ _WEIGHT
    mean, half = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
    ratio = np.sqrt(np.maximum(mean - half, 0) / np.maximum(mean + half, 1e-6))
    ratio = np.maximum(ratio, 1e-6)
    times = np.minimum(np.maximum(1 / ratio, SLIPPERY / ratio**2), MOST)
    # the eigenvector of the larger eigenvalue is normal to the edge
    normal = 0.5 * np.arctan2(2 * xy, xx - yy)
    size = np.sqrt(1 - 1 / times)
    return np.asarray(np.stack([-np.sin(normal) * size, np.cos(normal) * size], 1), np.float32)


def across(edge: Float32, error: Float32) -> Float32:
    """What errors (N, 2) px count for at points with edges (N, 2): sigmas times sigma across."""
    return np.asarray(error - edge * (edge * error).sum(1, keepdims=True), np.float32)
