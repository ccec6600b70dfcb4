"""Similarity transforms, Sim(3), and their least-squares estimation from point pairs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calm_edge.geometry import se3

Float = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Similarity:
    """Similarity target = scale * R @ source + t. R: (3, 3), t: (3,) in the target's unit."""

    scale: float
    R: Float
    t: Float

    @classmethod
    def from_matrix(cls, T: Float) -> Similarity:
        """Similarity of a matrix T (4, 4) = [[scale R, t], [0, 1]]."""
        scale = float(np.cbrt(np.linalg.det(T[:3, :3])))
        return cls(scale, T[:3, :3] / scale, T[:3, 3])

    def matrix(self) -> Float:
        """Matrix (4, 4) = [[scale R, t], [0, 1]]."""
        return se3.compose(self.scale * self.R, self.t)

    def points(self, p: Float) -> Float:
        """Transform points (..., 3) from source to target."""
        return np.asarray(self.scale * (p @ self.R.T) + self.t)

    def inverse(self) -> Similarity:
        """The inverse transform, target to source."""
        R = self.R.T
        return Similarity(1 / self.scale, R, -(R @ self.t) / self.scale)

    def poses(self, T: Float) -> Float:
        """Transform poses (..., 4, 4) from source to target; they stay rigid."""
        return se3.compose(self.R @ T[..., :3, :3], self.points(T[..., :3, 3]))


def align(
    source: Float, target: Float, with_scale: bool, weights: Float | None = None
) -> Similarity:
    """Least-squares similarity, or rigid motion (scale 1), from source (N, 3) to target (N, 3).

    N >= 2. weights: (N,) >= 0, not all 0, of the squared distances; None: equal. For collinear
    points the rotation about the line is arbitrary. Umeyama, "Least-squares estimation of
    transformation parameters between two point patterns", 1991, Eqs. (34)-(43).
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
