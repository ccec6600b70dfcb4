"""The pinhole camera: K (3, 3) px, points in camera axes (x right, y down, z forward)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]


def matrix(fx: float, fy: float, cx: float, cy: float) -> Float:
    """K (3, 3) from focals and principal point, px."""
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])


def from_hfov(hfov_deg: float, width: int, height: int) -> Float:
    """K (3, 3) of a horizontal field of view, principal point at the image centre."""
    f = width / 2 / np.tan(np.radians(hfov_deg) / 2)
    return matrix(f, f, (width - 1) / 2, (height - 1) / 2)


def project(K: Float, p_c: Float) -> Float:
    """Camera points (..., 3) -> pixels (..., 2); z <= 0 gives values the caller must mask."""
    z = np.where(p_c[..., 2:] == 0, 1e-12, p_c[..., 2:])
    q = p_c[..., :2] / z
    return np.stack(
        [
            K[..., 0, 0] * q[..., 0] + K[..., 0, 1] * q[..., 1] + K[..., 0, 2],
            K[..., 1, 1] * q[..., 1] + K[..., 1, 2],
        ],
        -1,
    )


def back_project(K: Float, uv: Float, depth: Float) -> Float:
    """Pixels (..., 2) and z-depths (...) -> camera points (..., 3) in the depth's unit."""
    y = (uv[..., 1] - K[..., 1, 2]) / K[..., 1, 1]
    x = (uv[..., 0] - K[..., 0, 2] - K[..., 0, 1] * y) / K[..., 0, 0]
    return np.stack([x * depth, y * depth, np.broadcast_to(depth, x.shape)], -1)


def resized(K: Float, sx: float, sy: float) -> Float:
    """K (..., 3, 3) after the image was resized by sx, sy the way cv2.resize does."""
    S = np.array([[sx, 0, (sx - 1) / 2], [0, sy, (sy - 1) / 2], [0, 0, 1.0]])
    return np.asarray(S @ K)
