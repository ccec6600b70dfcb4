"""Thin-plate splines in 3-D: smooth deformations given by control points (paper VI-D)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]

# number of points evaluated at once: distances to 150 control points fit into the CPU cache
TILE = 512
# control points with a singular value below this share of the largest count as flat
FLAT = 1e-3


@dataclass(frozen=True, slots=True)
class ThinPlate:
    """Deformation Phi(x) = x A + t + sum_i w_i |x - p_i|, in coordinates (x - centre) / size.

    centre: (3,), size: scalar, in the unit of the points. Dimensionless: controls (N, 3) p_i,
    weights (N, 3) w_i, affine (4, 3) rows of A, then t.
    """

    centre: Float
    size: float
    controls: Float
    weights: Float
    affine: Float

    def apply(self, points: NDArray[np.floating]) -> Float:
        """Deform points (M, 3). Works in tiles of 512 points, so memory is O(N).

        Squared distances are computed by a matrix product, whose cancellation error near a
        control point is about 1e-8 of `size` times its weight.
        """
        points = np.asarray(points, np.float64)
        out = np.empty_like(points)
        p = self.controls
        # |x - p|^2 = (x, |x|^2, 1) . (-2 p, 1, |p|^2)
        right = np.vstack([-2 * p.T, np.ones(len(p)), (p**2).sum(1)])
        for start in range(0, len(points), TILE):
            x = (points[start : start + TILE] - self.centre) / self.size
            y = x @ self.affine[:3] + self.affine[3]
            if len(p):
                left = np.column_stack([x, (x**2).sum(1), np.ones(len(x))])
                r = left @ right
                np.sqrt(np.maximum(r, 0, out=r), out=r)
                y += r @ self.weights
            out[start : start + TILE] = y * self.size + self.centre
        return out

    def determinants(self, points: NDArray[np.floating]) -> Float:
        """Jacobian determinants (M,) at points (M, 3); <= 0 where the deformation folds."""
        x = (np.asarray(points, np.float64) - self.centre) / self.size
        return np.asarray(np.linalg.det(self._jacobian(x)))

    def worst_at_controls(self) -> Float:
        """Lower bound (N,) of the Jacobian determinant near each control point.

        |x - p_i| is not differentiable at p_i: next to it the Jacobian is J + w_i e^T for a unit
        vector e of any direction, and its determinant at least det(J) (1 - |J^-1 w_i|).
        """
        J = self._jacobian(self.controls)
        det = np.linalg.det(J)
        safe = np.where(np.abs(det)[:, None, None] > 1e-9, J, np.eye(3))
        reach = np.linalg.norm(np.linalg.solve(safe, self.weights[..., None])[..., 0], axis=-1)
        return np.where(np.abs(det) > 1e-9, det * (1 - reach), 0.0)

    def _jacobian(self, x: Float) -> Float:
        """Jacobians (M, 3, 3) at normalised points (M, 3).

        A control point at the point itself is left out: its term has no derivative there.
        """
        from scipy.spatial.distance import cdist

        J = np.broadcast_to(self.affine[:3].T, (len(x), 3, 3)).copy()
        if len(self.controls):
            r = cdist(x, self.controls)
            g = np.divide(1.0, r, out=np.zeros_like(r), where=r > 1e-12)
            outer = (self.weights[:, :, None] * self.controls[:, None, :]).reshape(-1, 9)
            J += (g @ self.weights)[:, :, None] * x[:, None, :] - (g @ outer).reshape(-1, 3, 3)
        return J


def fit(source: Float, target: Float, stiffness: float) -> ThinPlate:
    """Fit a thin-plate spline from source (N, 3) to target (N, 3), kernel U(r) = r (paper VI-D).

    Minimises, over source points p_i and targets q_i, sum |Phi(p_i) - q_i|^2 + stiffness * bending
    energy; 0 interpolates. Stiffness is dimensionless, because points are first centred and divided
    by their RMS radius. The model depends on the extent of `source`: thin plate (at least 4 points
    not in a plane), rigid motion (plane), translation (line or point), identity (no points). Rows
    that are not finite are ignored. Raises ValueError for different shapes or negative stiffness.
    Bookstein, "Principal warps", 1989.
    """
    source, target = np.asarray(source, np.float64), np.asarray(target, np.float64)
    if source.shape != target.shape or source.ndim != 2 or source.shape[1] != 3:
        raise ValueError(f"control points: expected two (N, 3), got {source.shape}, {target.shape}")
    if not stiffness >= 0:
        raise ValueError(f"stiffness: expected >= 0, got {stiffness}")
    finite = np.isfinite(source).all(1) & np.isfinite(target).all(1)
    source, target = source[finite], target[finite]
    if not len(source):
        return _affine_only(np.zeros(3), np.eye(3), np.zeros(3))
    centre, singular = _extent(source)
    size = float(np.sqrt((singular**2).sum() / len(source)))
    if len(source) < 4 or singular[2] <= FLAT * singular[0]:
        return fit_rigid(source, target)
    x, y = (source - centre) / size, (target - centre) / size
    solution = _solve(x, y, stiffness)
    if solution is None:
        return fit_rigid(source, target)
    return ThinPlate(centre, size, x, solution[: len(x)], solution[len(x) :])


def fit_rigid(source: Float, target: Float) -> ThinPlate:
    """Least-squares rigid motion of finite pairs (N, 3), N >= 1, as ThinPlate without controls.

    Only a translation if the points are on a line or coincide.
    """
    centre, singular = _extent(source)
    shift = target.mean(0) - centre
    if len(source) < 3 or singular[1] <= FLAT * singular[0]:
        return _affine_only(centre, np.eye(3), shift)
    U, _, Vt = np.linalg.svd((source - centre).T @ (target - target.mean(0)))
    flip = np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])
    return _affine_only(centre, U @ flip @ Vt, shift)


def _affine_only(centre: Float, A: Float, t: Float) -> ThinPlate:
    none = np.empty((0, 3))
    return ThinPlate(centre, 1.0, none, none, np.vstack([A, t]))


def _extent(points: Float) -> tuple[Float, Float]:
    """Centre (3,) and the three singular values of the centred points, largest first."""
    centre = points.mean(0)
    singular = np.linalg.svd(points - centre, compute_uv=False)
    return centre, np.pad(singular, (0, 3 - len(singular)))


def _solve(x: Float, y: Float, stiffness: float) -> Float | None:
    """Solve for weights, A and t (N + 4, 3); None if the system is singular.

    In 3-D the conditionally positive definite kernel is -|x|, so with U(r) = +r the stiffness is
    subtracted from the diagonal.
    """
    from scipy.spatial.distance import cdist

    n = len(x)
    # above 0: coincident source points with different targets cannot be interpolated
    stiffness = max(stiffness, 1e-10)
    L = np.zeros((n + 4, n + 4))
    L[:n, :n] = cdist(x, x) - stiffness * np.eye(n)
    L[:n, n : n + 3], L[:n, n + 3] = x, 1.0
    L[n:, :n] = L[:n, n:].T
    rhs = np.vstack([y, np.zeros((4, 3))])
    try:
        solution = np.linalg.solve(L, rhs)
    except np.linalg.LinAlgError:
        return None
    good = np.isfinite(solution).all() and np.abs(L @ solution - rhs).max() < 1e-6
    return np.asarray(solution) if good else None
