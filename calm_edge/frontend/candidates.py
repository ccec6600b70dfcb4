"""Track new corners and triangulate them, to extend a sub-map until the next one is ready.

A sub-map is ready seconds after its frames, and a fast car has then passed most of its points. New
corners are triangulated between the tracker's own poses; the next sub-map replaces them, so their
drift is limited to one window.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calm_edge.geometry import picture_mask, se3
from calm_edge.geometry.camera import Camera
from calm_edge.geometry.flow import corners, follow
from calm_edge.types import Bytes, Float, Float32

# smallest angle between the rays; the depth error is then a few percent
MIN_PARALLAX_RAD = 0.025
MAX_ERROR_PX = 1.0
MIN_DEPTH = 1e-3


@dataclass(frozen=True, slots=True)
class Candidates:
    """Tracked corners that have no depth yet.

    uv: (M, 2) px, current. first_uv (M, 2), first_T_m_c (M, 4, 4) camera->map: at detection.
    """

    uv: Float32
    first_uv: Float32
    first_T_m_c: Float

    @staticmethod
    def none() -> Candidates:
        """An empty set."""
        empty = np.zeros((0, 2), np.float32)
        return Candidates(empty, empty, np.zeros((0, 4, 4)))

    def moved_to(self, T_new_old: Float) -> Candidates:
        """Transform to another map frame."""
        return Candidates(self.uv, self.first_uv, T_new_old @ self.first_T_m_c)

    def kept(self, keep: np.ndarray) -> Candidates:
        """Subset by mask or indices."""
        return Candidates(self.uv[keep], self.first_uv[keep], self.first_T_m_c[keep])


def step(
    known: Candidates, previous: Bytes, gray: Bytes, camera: Camera, T_m_c: Float
) -> tuple[Candidates, Float, Float32]:
    """Track candidates into image `gray` with pose T_m_c (4, 4), and triangulate.

    Returns the remaining candidates, and the triangulated points (P, 3), map frame, with their
    pixels (P, 2).
    """
    moved, good = follow(previous, gray, known.uv)
    known = Candidates(moved[good], known.first_uv[good], known.first_T_m_c[good])
    if len(known.uv) == 0:
        return known, np.zeros((0, 3)), known.uv
    ones = np.ones(len(known.uv))
    R, c = known.first_T_m_c[:, :3, :3], known.first_T_m_c[:, :3, 3]
    a = (R @ camera.back_project(known.first_uv.astype(np.float64), ones)[..., None])[..., 0]
    b = camera.back_project(known.uv.astype(np.float64), ones) @ T_m_c[:3, :3].T
    across = np.linalg.norm(np.cross(a, b), axis=-1)
    angle = across / (np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1))
    wide = angle > MIN_PARALLAX_RAD
    # point of ray a nearest to ray b; both have z-depth 1, so the factor of a is the depth
    base = T_m_c[:3, 3] - c
    normal = np.cross(a, b)
    depth = (np.cross(base, b) * normal).sum(-1) / np.maximum(across**2, 1e-18)
    p_m = c + depth[:, None] * a
    p_c = se3.transform(se3.inverse(T_m_c), p_m)
    miss = np.linalg.norm(camera.project(p_c) - known.uv, axis=-1)
    fine = wide & (depth > MIN_DEPTH) & (p_c[:, 2] > MIN_DEPTH) & (miss < MAX_ERROR_PX)
    return known.kept(~wide), p_m[fine], known.uv[fine]


def replenish(
    known: Candidates,
    gray: Bytes,
    taken: Float32,
    T_m_c: Float,
    n: int,
    mask: Bytes | None = None,
) -> Candidates:
    """Add corners of `gray`, up to `n` in all, not near known ones or pixels `taken` (Q, 2).

    mask: part of the picture that is left out, or None.
    """
    height, width = gray.shape
    used = None if mask is None else picture_mask.kept(mask, (height, width))
    fresh = corners(gray, n, np.concatenate([known.uv, taken]), used)
    fresh = fresh[: max(0, n - len(known.uv))]
    born = np.broadcast_to(T_m_c, (len(fresh), 4, 4))
    return Candidates(
        np.concatenate([known.uv, fresh]),
        np.concatenate([known.first_uv, fresh]),
        np.concatenate([known.first_T_m_c, born]),
    )
