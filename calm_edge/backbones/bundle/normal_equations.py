"""Normal equations of one window, points eliminated by the Schur complement, in numpy.

Bundle adjustment as in Triggs et al., Bundle Adjustment: A Modern Synthesis, 1999, section 6.1. The
reduced system has 6 unknowns per view and those of the kit, some 200 in all: dense is fastest.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from calm_edge.backbones.bundle.problem import (
    Measurements,
    ReprojectionJacobians,
    RigTies,
    State,
    reprojection,
    tangent_basis,
    tie_jacobians,
    times,
)
from calm_edge.kit import layout
from calm_edge.types import Float, Int

# Added to the diagonal of each point's block, a value and a share of the largest entry, so that
# blocks of points without observations, or next to a camera, are invertible.
POINT_FLOOR = 1e-3
POINT_FLOOR_SHARE = 1e-10


@dataclass(frozen=True, slots=True)
class Groups:
    """Rows (O,) grouped by equal key, to sum the blocks of each of G groups.

    order: (O,) rows sorted by key. starts: (G,) first position of each group in `order`. keys: (G,)
    distinct keys, ascending.
    """

    order: Int
    starts: Int
    keys: Int

    def sum(self, blocks: Float) -> Float:
        """Sum blocks (..., O) over rows of equal key -> (..., G)."""
        return np.asarray(np.add.reduceat(blocks.take(self.order, -1), self.starts, -1))


def grouped(key: Int) -> Groups:
    """Group rows by keys (O,), none negative."""
    order = np.argsort(key, kind="stable")
    starts = np.flatnonzero(np.diff(key[order], prepend=-1))
    return Groups(order, starts, key[order][starts])


def unknowns(m: Measurements) -> Int:
    """Indices (C, 6 + terms) in H of each view's pose and the terms of its eye."""
    terms = 6 * m.n_views + layout.EYE[m.eye]
    return np.concatenate([6 * np.arange(m.n_views)[:, None] + np.arange(6), terms], 1)


@dataclass(frozen=True, slots=True)
class Structure:
    """Sparsity of a window's normal equations, constant while it is solved.

    C views, M points, O observations. views: slice of each view's observations. by_point: the
    observations grouped by point; by_point_and_eye: by 2 * point + eye. cross: (18, O) indices,
    into the flattened Normal.cross, of each observation's block of 6 x 3: its view's pose by its
    point.
    """

    views: tuple[slice, ...]
    by_point: Groups
    by_point_and_eye: Groups
    rows: Int  # `unknowns`
    cross: Int

    @classmethod
    def of(cls, m: Measurements, n_points: int) -> Structure:
        bounds = np.searchsorted(m.view, np.arange(m.n_views + 1))
        return cls(
            tuple(slice(first, last) for first, last in pairwise(bounds)),
            grouped(m.point),
            grouped(2 * m.point + m.eye[m.view]),
            unknowns(m),
            (18 * m.view + np.arange(18)[:, None]) * n_points + m.point,
        )


@dataclass(frozen=True, slots=True)
class Normal:
    """Reduced normal equations H (D, D), g (D,) of D unknowns: the poses, then the kit.

    The M points are eliminated. For their back-substitution, with L L^T the inverse of a point's
    own 3 x 3 block: root (M, 3, 3) is L; cross (D, 3, M) the blocks of reduced unknowns by points,
    times L; gradient (3, M) the gradient by the points, times L.
    """

    H: Float
    g: Float
    root: Float
    cross: Float
    gradient: Float

    def point_step(self, delta: Float) -> Float:
        """Back-substitution: the points' step (M, 3) for a step (D,) of the reduced unknowns."""
        D = len(delta)
        coupled = self.gradient + (delta @ self.cross.reshape(D, -1)).reshape(3, -1)
        return np.asarray(-(self.root @ coupled.T[..., None])[..., 0])


def _scatter(H: Float, rows: np.ndarray, blocks: Float) -> None:
    """Add B blocks (B, k, k) to H, each at the k rows and columns in its row of `rows` (B, k)."""
    np.add.at(H, (rows[:, :, None], rows[:, None, :]), blocks)


def normal_equations(
    state: State,
    m: Measurements,
    ties: RigTies,
    structure: Structure,
    weight: Float,
    damping: float,
) -> Normal:
    """Normal equations of measurements and ties; the caller adds the kit prior and the gauge."""
    n_views, n_points = m.n_views, len(state.points)
    D = 6 * n_views + layout.SIZE
    jac = reprojection(state, m, tangent_basis(state.points))
    root_weight = np.sqrt(weight) * jac.in_front
    r = m.whitened((jac.predicted - m.uv).T) * root_weight
    camera, point = m.whitened(jac.camera) * root_weight, m.whitened(jac.point) * root_weight

    H, g = np.zeros((D, D)), np.zeros(D)
    joined = [
        np.concatenate([camera[..., rows], r[None, :, rows]]).reshape(len(camera) + 1, -1)
        for rows in structure.views
    ]
    own = np.stack([J @ J.T for J in joined])
    _scatter(H, structure.rows, own[:, :-1, :-1])
    np.add.at(g, structure.rows, own[:, :-1, -1])

    Hpp = np.tile(np.eye(3), (n_points, 1, 1))
    gp = np.zeros((n_points, 1, 3))
    seen, by_point = structure.by_point.keys, structure.by_point
    Hpp[seen] = by_point.sum(np.einsum("iko,jko->ijo", point, point)).transpose(2, 0, 1)
    gp[seen, 0] = by_point.sum(np.einsum("iko,ko->io", point, r)).T
    diagonal = np.einsum("mii->mi", Hpp)
    largest = diagonal.max(1, keepdims=True)
    diagonal += damping * diagonal + POINT_FLOOR_SHARE * largest + POINT_FLOOR
    root = np.linalg.inv(np.linalg.cholesky(Hpp)).transpose(0, 2, 1)
    gradient = np.ascontiguousarray((gp @ root)[:, 0].T)

    blocks = np.einsum("iko,jko->ijo", camera, times(point, root, m.point))
    cross = np.zeros((D, 3, n_points))
    # no sum is needed: a view observes a point at most once
    cross.reshape(-1)[structure.cross] = blocks[:6].reshape(18, -1)
    pairs = structure.by_point_and_eye
    terms = 6 * n_views + layout.EYE[pairs.keys % 2]
    cross[terms, :, pairs.keys[:, None] // 2] = pairs.sum(blocks[6:]).transpose(2, 0, 1)
    flat = cross.reshape(D, -1)
    H -= flat @ flat.T
    g -= flat @ gradient.reshape(-1)

    by_ties = tie_equations(state, m, ties)
    return Normal(H + by_ties[0], g + by_ties[1], root, cross, gradient)


def track_gradients(
    m: Measurements, jac: ReprojectionJacobians, normal: Normal, error: Float
) -> Float:
    """Each of the M points' part (D, M) of the gradient by poses and kit, the point eliminated.

    error: (2, O) px, times the weights.
    """
    D, n_points = len(normal.g), normal.root.shape[0]
    # whitening is symmetric: twice is a product with the information
    pull = m.whitened(m.whitened(error)) * jac.in_front
    by_camera = np.einsum("iko,ko->io", jac.camera, pull)
    by_point = np.einsum("iko,ko->io", jac.point, pull)
    rows = unknowns(m)[m.view].T
    out = np.zeros((D, n_points))
    np.add.at(out, (rows, m.point), by_camera)
    own = np.stack([np.bincount(m.point, part, n_points) for part in by_point])
    return np.asarray(
        out - np.einsum("dkm,mjk,jm->dm", normal.cross, normal.root, own, optimize=True)
    )


def tie_equations(state: State, m: Measurements, ties: RigTies) -> tuple[Float, Float]:
    """Part of the normal equations that comes from the rig ties alone."""
    n_views = m.n_views
    D = 6 * n_views + layout.SIZE
    H, g = np.zeros((D, D)), np.zeros(D)
    if len(ties.alpha):
        residual, J = tie_jacobians(state, ties)
        views = np.stack([ties.before, ties.after, ties.assistant], 1)
        kit = 6 * n_views + np.r_[layout.RIG, layout.TIME_OFFSET]
        tie_rows = np.concatenate(
            [
                (6 * views[..., None] + np.arange(6)).reshape(-1, 18),
                np.broadcast_to(kit, (len(ties.alpha), len(kit))),
            ],
            1,
        )
        J_t = J.transpose(0, 2, 1)
        _scatter(H, tie_rows, J_t @ J)
        np.add.at(g, tie_rows, (J_t @ residual[..., None])[..., 0])
    return H, g


def fix_spacing(H: Float, theta: Float, sigma: float) -> None:
    """Fix the gauge |t_p_a| = 1 by a stiff prior along t_p_a; the solver rescales to exactly 1."""
    row = np.zeros(layout.SIZE)
    row[layout.RIG_CENTRE] = theta[layout.RIG_CENTRE] / sigma
    H[-layout.SIZE :, -layout.SIZE :] += np.outer(row, row)
