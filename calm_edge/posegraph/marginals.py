"""Covariances of the optimised poses, propagated from the pose errors of single views.

To first order the optimum is linear in the measurement errors. Edges of one sub-map share views,
so that their errors are correlated and the inverse Hessian is no covariance, not even up to a
factor. Instead the covariance is the sum over views of J Q J^T: J the derivative of a pose by the
view's error, Q the view's covariance from `noise`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from calm_edge.geometry import se3
from calm_edge.posegraph.linear_system import Rows, linearise
from calm_edge.posegraph.noise import Noise
from calm_edge.posegraph.problem import Problem, State, cauchy, residuals, robust_weights
from calm_edge.types import Float, Int


class Marginals:
    """Covariances of keyframes in the graph linearised at its optimum.

    They do not include the effect of a constant error of the focal length.
    """

    def __init__(self, problem: Problem, state: State, noise: Noise) -> None:
        self._problem, self._state, self._noise = problem, state, noise
        r = residuals(problem, state)
        every = np.arange(len(problem.edges.i))
        self._rows = linearise(problem, state, r, robust_weights(problem, r, cauchy), every)
        J = se3.right_jacobian_inverse(r.prior) / problem.sigma_prior[:, None]
        self._prior = J.T @ J
        self._n = len(state.T_w_p)
        self._factor, self._border, self._rest = self._factorise()

    def covariances(self, rows: Int, origin: int = 0) -> Float:
        """Covariances (M, 6, 6) of keyframes at state rows `rows` (M,) relative to row `origin`.

        (translation, rotation) in the keyframe's own camera axes, world units and rad.
        """
        return np.stack([self._covariance(self._sensitivity(int(row), origin)) for row in rows])

    def _factorise(self) -> tuple[Any, Float, Float]:
        """Factorise the Hessian [P B; B^T R] of poses (without the first) and T_p_a.

        Returns the sparse factor of P, P^-1 B (6 N - 6, 6) and the Schur complement
        R - B^T P^-1 B (6, 6). T_p_a is eliminated separately, because its rows are dense.
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

    def _sensitivity(self, row: int, origin: int) -> Float:
        """H^-1 D^T (N + 1, 6, 6): H Hessian, D derivative of pose `row` relative to `origin`."""
        target = np.zeros((self._n + 1, 6, 6))
        T_w_p = self._state.T_w_p
        target[row] = np.eye(6)
        target[origin] -= se3.adjoint(se3.inverse(T_w_p[row]) @ T_w_p[origin]).T
        X = np.zeros_like(target)
        b = target[1:-1].reshape(-1, 6)
        X[-1] = -np.linalg.solve(self._rest, self._border.T @ b)
        X[1:-1] = (self._factor.solve(b) - self._border @ X[-1]).reshape(-1, 6, 6)
        return X

    def _covariance(self, X: Float) -> Float:
        """Covariance (6, 6) of a relative pose.

        Sum over the errors of all views, sub-map scales, loops, the prior and bridges, the edges
        that stand for windows without a sub-map. X: (N + 1, 6, 6) from `_sensitivity`, the inverse
        Hessian times the transposed derivative of the relative pose.
        """
        edges, rows = self._problem.edges, self._rows
        U = rows.by_i @ X[edges.i] + rows.by_j @ X[edges.j] + rows.by_rig @ X[-1]
        Q = self._noise.view_covariance()
        from_submap = edges.submap >= 0
        single = U[~from_submap, :6].reshape(-1, 6)
        total = single.T @ single
        for G in self._by_view(rows, U, from_submap):
            total += np.einsum("vai,ab,vbj->ij", G, Q, G, optimize=True)
        along = self._by_scale(rows, U, from_submap)
        total += self._noise.scale**2 * along.T @ along
        by_prior = self._prior @ X[-1]
        return np.asarray(total + by_prior.T @ Q @ by_prior)

    def _by_view(self, rows: Rows, U: Float, kept: Any) -> tuple[Float, Float]:
        """Derivatives by the pose error of each primary and each assistant view, (V, 6, 6) each.

        A keyframe in two sub-maps counts as two views. kept: (P,) mask of the edges of sub-maps.
        """
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

    def _by_scale(self, rows: Rows, U: Float, kept: Any) -> Float:
        """Derivatives (S, 6) by the log scale of each sub-map."""
        edges = self._problem.edges
        total = np.zeros((int(edges.submap.max()) + 1, 6))
        turns = (np.eye(6), se3.adjoint(self._state.T_p_a))
        for T_j_i, half, turn in zip(
            (edges.T_j_i, edges.T_j_i_assistant), (slice(0, 6), slice(6, 12)), turns, strict=True
        ):
            # derivative of a measurement by log scale: its translation, in the axes of view i
            moved = np.zeros((int(kept.sum()), 6))
            moved[:, :3] = -se3.inverse(T_j_i[kept])[:, :3, 3]
            by = (rows.by_i[kept, half] @ turn @ moved[..., None])[..., 0]
            np.add.at(total, edges.submap[kept], np.einsum("pra,pr->pa", U[kept, half], by))
        return total
