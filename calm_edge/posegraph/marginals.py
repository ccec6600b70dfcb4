"""How far the optimised poses may be off: errors of the views, carried through the optimum.

The optimum is a linear function of small measurement errors. Edges of one sub-map share their
views, so their errors are not independent and the inverse of the normal matrix is not the
covariance, whatever it is scaled by: here each view's error is followed on its own, a sum over
views of (influence) Q (influence)^T with Q from `noise`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from calm_edge.geometry import se3
from calm_edge.posegraph.linear_system import Rows, linearise
from calm_edge.posegraph.noise import Noise
from calm_edge.posegraph.problem import Problem, State, cauchy, residuals, softening
from calm_edge.types import Float, Int


class Marginals:
    """The graph linearised at its optimum: covariances of any of its keyframes.

    A focal length that is wrong throughout is not in it.
    """

    def __init__(self, problem: Problem, state: State, noise: Noise) -> None:
        self._problem, self._state, self._noise = problem, state, noise
        r = residuals(problem, state)
        every = np.arange(len(problem.edges.i))
        self._rows = linearise(problem, state, r, softening(problem, r, cauchy), every)
        J = se3.right_jacobian_inverse(r.prior) / problem.sigma_prior[:, None]
        self._prior = J.T @ J
        self._n = len(state.T_w_p)
        self._factor, self._border, self._rest = self._factorise()

    def covariances(self, rows: Int, origin: int = 0) -> Float:
        """(M, 6, 6) of keyframes `rows` (M,) of the state against keyframe `origin`.

        (translation, rotation) in the keyframe's own camera axes, world units and rad.
        """
        return np.stack([self._spread(self._influenced(int(row), origin)) for row in rows])

    def graph_covariances(self, rows: Int) -> Float:
        """(M, 6, 6) against the first keyframe, were the paper's variances the errors."""
        return np.stack([self._influenced(int(row), 0)[row] for row in rows])

    def _factorise(self) -> tuple[Any, Float, Float]:
        """H without the first keyframe, which holds the world, T_p_a's border apart.

        The factor of the poses' part P, P^-1 B (6 N - 6, 6) of the border B, and the rest (6, 6)
        that the border leaves of T_p_a: a dense row would ruin the order of elimination.
        """
        edges, n_pairs, n_poses = self._problem.edges, len(self._problem.edges.i), 6 * self._n
        ends = np.stack([edges.i, edges.j], 1)[..., None] * 6 + np.arange(6)
        columns = np.broadcast_to(ends.reshape(n_pairs, 1, 12), (n_pairs, 12, 12)).ravel()
        values = np.concatenate([self._rows.by_i, self._rows.by_j], -1).ravel()
        starts = np.arange(0, len(values) + 1, 12)
        J = sparse.csr_matrix((values, columns, starts), (12 * n_pairs, n_poses)).tocsc()[:, 6:]
        by_rig = self._rows.by_rig.reshape(-1, 6)
        border = J.T @ by_rig
        options = {"SymmetricMode": True}
        P = sparse.csc_matrix(J.T @ J)
        factor = splu(P, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
        Z = factor.solve(border)
        return factor, Z, by_rig.T @ by_rig + self._prior - border.T @ Z

    def _influenced(self, row: int, origin: int) -> Float:
        """X (N + 1, 6, 6): column k is H^-1 of the k-th axis of `row` seen from `origin`."""
        target = np.zeros((self._n + 1, 6, 6))
        T_w_p = self._state.T_w_p
        target[row] = np.eye(6)
        target[origin] -= se3.adjoint(se3.inverse(T_w_p[row]) @ T_w_p[origin]).T
        X = np.zeros_like(target)
        b = target[1:-1].reshape(-1, 6)
        X[-1] = -np.linalg.solve(self._rest, self._border.T @ b)
        X[1:-1] = (self._factor.solve(b) - self._border @ X[-1]).reshape(-1, 6, 6)
        return X

    def _spread(self, X: Float) -> Float:
        """(6, 6): what the errors of all views, bridges, loops and the prior amount to."""
        edges, rows = self._problem.edges, self._rows
        U = rows.by_i @ X[edges.i] + rows.by_j @ X[edges.j] + rows.by_rig @ X[-1]
        Q = self._noise.view_covariance()
        from_submap = edges.submap >= 0
        single = U[~from_submap, :6].reshape(-1, 6)
        total = single.T @ single
        for G in self._views(rows, U, from_submap):
            total += np.einsum("vai,ab,vbj->ij", G, Q, G, optimize=True)
        along = self._scales(rows, U, from_submap)
        total += self._noise.scale**2 * along.T @ along
        by_prior = self._prior @ X[-1]
        return np.asarray(total + by_prior.T @ Q @ by_prior)

    def _views(self, rows: Rows, U: Float, kept: Any) -> tuple[Float, Float]:
        """Influence (V, 6, 6) of every view of every sub-map: primary, then assistant."""
        edges = self._problem.edges
        submap, i, j = edges.submap[kept], edges.i[kept], edges.j[kept]
        ends = np.concatenate([submap * self._n + i, submap * self._n + j])
        views, view = np.unique(ends, return_inverse=True)
        sums = sparse.csr_matrix((np.ones(len(view)), (view, np.arange(len(view)))))
        to_primary = se3.adjoint(self._state.T_p_a)
        out = []
        for half, turn in ((slice(0, 6), np.eye(6)), (slice(6, 12), to_primary)):
            U_half = U[kept, half]
            by = np.concatenate([rows.by_i[kept, half], rows.by_j[kept, half]]) @ turn
            G = np.swapaxes(by, -1, -2) @ np.concatenate([U_half, U_half])
            out.append((sums @ G.reshape(-1, 36)).reshape(len(views), 6, 6))
        return out[0], out[1]

    def _scales(self, rows: Rows, U: Float, kept: Any) -> Float:
        """Influence (S, 6) of the log scale of every sub-map."""
        edges = self._problem.edges
        total = np.zeros((int(edges.submap.max()) + 1, 6))
        turns = (np.eye(6), se3.adjoint(self._state.T_p_a))
        for T_j_i, half, turn in zip(
            (edges.T_j_i, edges.T_j_i_assistant), (slice(0, 6), slice(6, 12)), turns, strict=True
        ):
            # a longer measurement is one whose view i has moved by its translation, in its axes
            moved = np.zeros((int(kept.sum()), 6))
            moved[:, :3] = -se3.inverse(T_j_i[kept])[:, :3, 3]
            by = (rows.by_i[kept, half] @ turn @ moved[..., None])[..., 0]
            np.add.at(total, edges.submap[kept], np.einsum("pra,pr->pa", U[kept, half], by))
        return total
