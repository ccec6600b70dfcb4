"""Corners on their way to become points: what carries the live pose from one sub-map to the next.

A window comes seconds after its frames, and at speed a car has then passed most of its points.
New corners are followed and triangulated between the tracker's own poses; the next sub-map
replaces them, so that their drift lasts no longer than a window.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera
from calm_edge.geometry.flow import corners, follow
from calm_edge.types import Bytes, Float, Float32

# Rays meet at this angle or more: a corner's noise is then a few percent of its depth.
MIN_PARALLAX_RAD = 0.025
MAX_MISS_PX = 1.0
MIN_DEPTH = 1e-3


@dataclass(frozen=True, slots=True)
class Candidates:
    """uv (M, 2) px now; born_uv (M, 2) px and born_T_m_c (M, 4, 4) where each was first seen."""

    uv: Float32
    born_uv: Float32
    born_T_m_c: Float

    @staticmethod
    def none() -> Candidates:
        """No candidates."""
        empty = np.zeros((0, 2), np.float32)
        return Candidates(empty, empty, np.zeros((0, 4, 4)))

    def moved_to(self, T_new_old: Float) -> Candidates:
        """The same in another map frame."""
        return Candidates(self.uv, self.born_uv, T_new_old @ self.born_T_m_c)

    def kept(self, keep: np.ndarray) -> Candidates:
        """Those of a mask or index."""
        return Candidates(self.uv[keep], self.born_uv[keep], self.born_T_m_c[keep])


def step(
    known: Candidates, previous: Bytes, gray: Bytes, camera: Camera, T_m_c: Float
) -> tuple[Candidates, Float, Float32]:
    """Follows candidates into `gray`, taken at T_m_c (4, 4).

    Returns those that go on, and of the ripe ones points (P, 3) in the map and their pixels (P, 2).
    """
    moved, good = follow(previous, gray, known.uv)
    known = Candidates(moved[good], known.born_uv[good], known.born_T_m_c[good])
    if len(known.uv) == 0:
        return known, np.zeros((0, 3)), known.uv
    ones = np.ones(len(known.uv))
    R, c = known.born_T_m_c[:, :3, :3], known.born_T_m_c[:, :3, 3]
    a = (R @ camera.back_project(known.born_uv.astype(np.float64), ones)[..., None])[..., 0]
    b = camera.back_project(known.uv.astype(np.float64), ones) @ T_m_c[:3, :3].T
    across = np.linalg.norm(np.cross(a, b), axis=-1)
    angle = across / (np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1))
    ripe = angle > MIN_PARALLAX_RAD
    # the point of ray a nearest to ray b; a and b have z-depth 1, so its factor is the depth
    base = T_m_c[:3, 3] - c
    normal = np.cross(a, b)
    depth = (np.cross(base, b) * normal).sum(-1) / np.maximum(across**2, 1e-18)
    p_m = c + depth[:, None] * a
    p_c = se3.transform(se3.inverse(T_m_c), p_m)
    miss = np.linalg.norm(camera.project(p_c) - known.uv, axis=-1)
    fine = ripe & (depth > MIN_DEPTH) & (p_c[:, 2] > MIN_DEPTH) & (miss < MAX_MISS_PX)
    return known.kept(~ripe), p_m[fine], known.uv[fine]


def replenish(known: Candidates, gray: Bytes, taken: Float32, T_m_c: Float, n: int) -> Candidates:
    """Up to `n` candidates: new corners of `gray` away from them and from pixels `taken` (Q, 2)."""
    fresh = corners(gray, n, np.concatenate([known.uv, taken]))
    fresh = fresh[: max(0, n - len(known.uv))]
    born = np.broadcast_to(T_m_c, (len(fresh), 4, 4))
    return Candidates(
        np.concatenate([known.uv, fresh]),
        np.concatenate([known.born_uv, fresh]),
        np.concatenate([known.born_T_m_c, born]),
    )
