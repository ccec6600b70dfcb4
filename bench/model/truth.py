"""True correspondences between pictures, from depth and poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera
from calm_edge.types import Float, Float32

Bool = NDArray[np.bool_]

# At a depth discontinuity the surface of a pixel is ambiguous. The inverse depth of a plane is
# linear over the picture, so a relative second difference above this marks a discontinuity.
EDGE_SHARE = 0.02
# A point is visible if its depth agrees with the other picture's depth within this share.
VISIBLE_SHARE = 0.02
MARGIN_PX = 4.0


@dataclass(frozen=True, slots=True)
class PosedDepth:
    """Truth of one picture: camera, T_w_c (4, 4) m, and z-depth (H, W) m, 0 for sky."""

    camera: Camera
    T_w_c: Float
    z: Float32


def transfer(a: PosedDepth, b: PosedDepth, uv: Float) -> tuple[Float, Bool]:
    """Transfer pixels uv (N, 2) of a to positions (N, 2) px in b.

    Also returns whether each is valid (N,). Invalid are sky, depth discontinuities, points behind b
    or less than MARGIN_PX inside its picture, and occluded points.
    """
    zeta, safe = _inverse_depth(a.z, uv)
    known = safe & (zeta > 0)
    p_a = a.camera.back_project(uv, 1 / np.where(known, zeta, 1.0))
    p_b = se3.transform(se3.inverse(b.T_w_c) @ a.T_w_c, p_a)
    known &= p_b[:, 2] > 1e-3
    there = b.camera.project(np.where(known[:, None], p_b, 1.0))
    height, width = b.z.shape
    last = np.array([width, height]) - 1 - MARGIN_PX
    inside = known & (there >= MARGIN_PX).all(1) & (there <= last).all(1)
    seen = np.zeros(len(uv), bool)
    seen[inside] = _seen(b.z, there[inside], 1 / p_b[inside, 2])
    return there, seen


def _corners(zeta: Float, uv: Float) -> tuple[Float, Float]:
    """The four samples (N, 4) around each of N pixels, and their bilinear weights (N, 4)."""
    height, width = zeta.shape
    low = np.clip(np.floor(uv).astype(np.int64), 0, [width - 2, height - 2])
    s, t = (uv - low).T
    x, y = low.T
    four = np.stack([zeta[y, x], zeta[y, x + 1], zeta[y + 1, x], zeta[y + 1, x + 1]], 1)
    weights = np.stack([(1 - s) * (1 - t), s * (1 - t), (1 - s) * t, s * t], 1)
    return np.asarray(four, np.float64), weights


def _inverse(z: Float32) -> Float:
    return np.where(z > 0, 1 / np.where(z > 0, z, 1.0), 0.0)


def _inverse_depth(z: Float32, uv: Float) -> tuple[Float, Bool]:
    """Inverse depth (N,) at pixels (N, 2); also whether their four neighbours are one surface."""
    zeta = _inverse(z)
    bend: Float = np.zeros_like(zeta)
    bend[:, 1:-1] = np.abs(zeta[:, :-2] - 2 * zeta[:, 1:-1] + zeta[:, 2:])
    bend[1:-1] = np.maximum(bend[1:-1], np.abs(zeta[:-2] - 2 * zeta[1:-1] + zeta[2:]))
    one_surface = (zeta > 0) & (bend < EDGE_SHARE * zeta)
    four, weights = _corners(zeta, uv)
    clear = _corners(one_surface.astype(np.float64), uv)[0].min(1) > 0
    return (four * weights).sum(1), clear


def _seen(z: Float32, uv: Float, zeta: Float) -> Bool:
    """Whether points at pixels uv (N, 2) with inverse depth zeta (N,) are visible, not occluded."""
    four, weights = _corners(_inverse(z), uv)
    around = np.concatenate([four, (four * weights).sum(1, keepdims=True)], 1)
    off = np.abs(around - zeta[:, None]).min(1)
    return np.asarray(off < VISIBLE_SHARE * zeta)
