"""Similarities of 3-D points: a rotation, a translation and one scale."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calm_edge.geometry import se3

Float = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Similarity:
    """target = scale * R @ source + t. R: (3, 3), t: (3,) target unit."""

    scale: float
    R: Float
    t: Float

    @classmethod
    def from_matrix(cls, T: Float) -> Similarity:
        """Of T (4, 4) = [[scale R, t], [0, 1]]."""
        scale = float(np.cbrt(np.linalg.det(T[:3, :3])))
        return cls(scale, T[:3, :3] / scale, T[:3, 3])

    def matrix(self) -> Float:
        """(4, 4) [[scale R, t], [0, 1]], which takes homogeneous source points to target."""
        return se3.compose(self.scale * self.R, self.t)

    def points(self, p: Float) -> Float:
        """(..., 3) source points -> target."""
        return np.asarray(self.scale * (p @ self.R.T) + self.t)

    def inverse(self) -> Similarity:
        """The map from target back to source."""
        R = self.R.T
        return Similarity(1 / self.scale, R, -(R @ self.t) / self.scale)

    def poses(self, T: Float) -> Float:
        """(..., 4, 4) source poses -> target; positions scale, rotations do not."""
        return se3.compose(self.R @ T[..., :3, :3], self.points(T[..., :3, 3]))


def align(
    source: Float, target: Float, with_scale: bool, weights: Float | None = None
) -> Similarity:
    """Least-squares similarity or rigid motion (scale 1) taking source (N, 3) to target (N, 3).

    weights: (N,) >= 0 and not all 0, of the squared distances; None is all alike.
    Umeyama, "Least-squares estimation of transformation parameters between two point
    patterns", 1991, Eqs. (34)-(43). N >= 2; a straight path leaves its roll at the smallest turn.
    """
    share = np.full(len(source), 1 / len(source)) if weights is None else weights / weights.sum()
    mean_s, mean_t = share @ source, share @ target
    ds, dt = source - mean_s, target - mean_t
    U, D, Vt = np.linalg.svd((share[:, None] * dt).T @ ds)
    S = np.array([1.0, 1.0, np.sign(np.linalg.det(U) * np.linalg.det(Vt)) or 1.0])
    R = (U * S) @ Vt
    variance = float(share @ (ds**2).sum(1))
    scale = float((D * S).sum()) / variance if with_scale and variance > 0 else 1.0
    return Similarity(scale, R, mean_t - scale * R @ mean_s)
