"""Normal equations of the joint graph, and their elimination by GTSAM (paper IV-C).

All residuals are linearised in numpy, in our twist order (translation, rotation); GTSAM gets
linear factors only. Calls from Python are slow, so that _GROUP consecutive keyframes form one
GTSAM variable (a *group*) and all edges between two groups are summed into one HessianFactor.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from calm_edge.geometry import se3
from calm_edge.posegraph import assistant_factor
from calm_edge.posegraph.problem import Edges, Kernel, Problem, Residuals, State, robust_weights
from calm_edge.types import Float, Int

# Keyframes per group. With a window of 3 predecessors, edges then reach the next group at most.
_GROUP = 3
# Number of edges linearised at once, so that temporary arrays fit into the CPU cache.
_CHUNK = 256


class Rows(NamedTuple):
    """Whitened Jacobians (P, 12, 6) of P edges by pose i, pose j and T_p_a; b = -residuals (P, 12).

    Rows 0-5 are the primary's residual, rows 6-11 the assistant's.
    """

    by_i: Float
    by_j: Float
    by_rig: Float
    b: Float


def linearise(problem: Problem, state: State, r: Residuals, soft: Float, pairs: Int) -> Rows:
    """Whitened Jacobians of the edges with indices `pairs` (Q,), at `state` with residuals `r`.

    soft: (P,) robust weights of the primary's residuals, from `robust_weights`.
    """
    edges, sigma = problem.edges, problem.sigma
    i, j = state.T_w_p[edges.i[pairs]], state.T_w_p[edges.j[pairs]]
    primary = assistant_factor.between(r.primary[pairs], i, j)
    assistant = assistant_factor.coupled(r.assistant[pairs], i, j, state.T_p_a)
    weight_p = np.sqrt(edges.weight[pairs] * soft[pairs])[:, None] / sigma
    weight_a = np.sqrt(edges.weight_assistant[pairs])[:, None] / sigma
    rows_p, rows_a = weight_p[..., None], weight_a[..., None]
    return Rows(
        by_i=np.concatenate([primary.by_i * rows_p, assistant.by_i * rows_a], 1),
        by_j=np.concatenate([primary.by_j * rows_p, assistant.by_j * rows_a], 1),
        by_rig=np.concatenate([np.zeros_like(primary.by_i), assistant.by_rig * rows_a], 1),
        b=-np.concatenate([r.primary[pairs] * weight_p, r.assistant[pairs] * weight_a], 1),
    )


class Layout:
    """Sparsity pattern of the system: the factor and the columns of each edge.

    Keyframes are padded to whole groups, at least two. Factor f joins groups low[f] and high[f]
    (F,): first all pairs of neighbouring groups, then the pairs joined by loops only. Columns of
    a factor: 6 per pose of `low`, 6 per pose of `high`, 6 of T_p_a, 1 of b.
    """

    def __init__(self, edges: Edges, n: int) -> None:
        self.n = n
        self.n_groups = max(2, -(-n // _GROUP))
        low = np.minimum(edges.i, edges.j) // _GROUP
        high = np.maximum(edges.i, edges.j) // _GROUP
        near = np.arange(self.n_groups - 1)
        is_far = high - low > 1
        far, factor = np.unique((low * self.n_groups + high)[is_far], return_inverse=True)
        self.low = np.concatenate([near, far // self.n_groups])
        self.high = np.concatenate([near + 1, far % self.n_groups])
        factor_of = np.minimum(low, self.n_groups - 2)
        factor_of[is_far] = len(near) + factor
        # mask of groups with a loop to a group that is not a neighbour
        self.looped = np.zeros(self.n_groups, bool)
        self.looped[self.low[len(near) :]] = self.looped[self.high[len(near) :]] = True
        self._order = np.argsort(factor_of, kind="stable")
        self._factor = factor_of[self._order]
        ends = np.stack([edges.i, edges.j], -1)[self._order]
        is_low = ends // _GROUP == self.low[self._factor][:, None]
        column = 6 * (ends % _GROUP + np.where(is_low, 0, _GROUP))
        # (P, 19): 6 columns of either pose, 6 of T_p_a, 1 of b
        both = (column[..., None] + np.arange(6)).reshape(-1, 12)
        rest = np.broadcast_to(12 * _GROUP + np.arange(7), (len(both), 7))
        self._columns = np.concatenate([both, rest], 1)

    def complete(self, n_factors: int) -> int:
        """Number of leading groups with all factors to neighbours among the first n_factors."""
        return self.n_groups if n_factors >= self.n_groups - 1 else n_factors

    def chunks(self) -> Iterator[tuple[slice, Int, Int, Int]]:
        """Chunks of whole factors with about _CHUNK edges each.

        Yields the slice of factors, the edge indices (Q,), each edge's factor relative to the
        slice's start (Q,), and its columns (Q, 19).
        """
        cuts = np.searchsorted(self._factor, self._factor[::_CHUNK])
        cuts = np.unique(np.append(cuts, len(self._factor)))
        for start, end in pairwise(cuts.tolist()):
            first, last = int(self._factor[start]), int(self._factor[end - 1])
            pairs, columns = self._order[start:end], self._columns[start:end]
            yield slice(first, last + 1), pairs, self._factor[start:end] - first, columns


def _blocks(rows: Rows, factor: Int, columns: Int, n_factors: int) -> Float:
    """Augmented Hessians [A b]^T [A b] (F, D, D), summed over the edges of each factor."""
    A = np.concatenate([rows.by_i, rows.by_j, rows.by_rig, rows.b[..., None]], -1)
    D = 12 * _GROUP + 7
    index = (factor[:, None, None] * D + columns[:, :, None]) * D + columns[:, None, :]
    # the copy avoids numpy's syrk path for A^T A, which is three times slower at this size
    products = np.swapaxes(A, -1, -2) @ A.copy()
    summed = np.bincount(index.ravel(), products.ravel(), n_factors * D * D)
    return np.asarray(summed.reshape(n_factors, D, D))


class LinearSystem:
    """The problem linearised at a state. GTSAM keys: groups 0 .. n_groups-1, then T_p_a.

    A group is eliminated as soon as all its factors have been added, so that memory holds the
    Bayes net and a few factors, never the whole graph. Groups with loops are eliminated last.
    """

    def __init__(
        self, problem: Problem, state: State, r: Residuals, kernel: Kernel, layout: Layout
    ) -> None:
        import gtsam

        self._gtsam: Any = gtsam
        self._problem, self._state, self._r, self._layout = problem, state, r, layout
        self._soft = robust_weights(problem, r, kernel)
        self._rig = layout.n_groups

    def solve(self, damping: float) -> Float | None:
        """Solution (N + 1, 6) of the damped normal equations: a twist per keyframe, then T_p_a's.

        None if they are numerically not positive definite, as over kilometres at low damping.
        """
        gtsam, layout = self._gtsam, self._layout
        graph, net, done = gtsam.GaussianFactorGraph(), gtsam.GaussianBayesNet(), 0
        self._add_priors(graph, damping)
        try:
            for factors, pairs, factor, columns in layout.chunks():
                rows = linearise(self._problem, self._state, self._r, self._soft, pairs)
                blocks = _blocks(rows, factor, columns, factors.stop - factors.start)
                self._join(graph, blocks, factors)
                ready = np.arange(done, layout.complete(factors.stop))
                self._damp(graph, ready, damping)
                done += len(ready)
                within = ready[~layout.looped[ready]].tolist()
                if within:
                    found, graph = graph.eliminatePartialSequential(gtsam.Ordering(within))
                    _append(net, found)
            self._damp(graph, np.arange(done, layout.n_groups), damping)
            # T_p_a is connected to every keyframe: eliminated last, the system stays banded
            ordering = gtsam.Ordering.ColamdConstrainedLastGaussianFactorGraph(graph, [self._rig])
            _append(net, graph.eliminateSequential(ordering))
            solution = net.optimize()
        except RuntimeError:
            return None
        steps = np.asarray(solution.vector(list(range(self._rig + 1)))).reshape(-1, 6)
        return np.concatenate([steps[: layout.n], steps[-1:]])

    def _add_priors(self, graph: Any, damping: float) -> None:
        """Add the prior on T_p_a, the gauge prior on keyframe 0, and identities for padding."""
        problem, r = self._problem, self._r
        J = se3.right_jacobian_inverse(r.prior) / problem.sigma_prior[:, None]
        self._add_rows(graph, self._rig, J, -r.prior / problem.sigma_prior)
        self._add_rows(graph, self._rig, np.sqrt(damping) * np.eye(6), np.zeros(6))
        # gauge: nothing else fixes the world frame, so a prior of any weight fixes it exactly
        held = np.zeros((6, 6 * _GROUP))
        held[:, :6] = np.diag(1 / problem.sigma)
        self._add_rows(graph, 0, held, np.zeros(6))
        rows = np.arange(self._layout.n, self._layout.n_groups * _GROUP)
        for group in np.unique(rows // _GROUP).tolist():
            empty = np.zeros(6 * _GROUP)
            for row in rows[rows // _GROUP == group] % _GROUP:
                empty[6 * row : 6 * row + 6] = 1.0
            self._add_rows(graph, group, np.diag(empty), np.zeros(6 * _GROUP))

    def _join(self, graph: Any, H: Float, factors: slice) -> None:
        """Add a HessianFactor between groups low and high for each block of H (F, D, D)."""
        g, r = 6 * _GROUP, 12 * _GROUP
        factor = self._gtsam.HessianFactor
        low, high = self._layout.low[factors].tolist(), self._layout.high[factors].tolist()
        for a, b, G in zip(low, high, H, strict=True):
            h = G[:, -1]
            graph.add(
                factor(
                    a, b, self._rig,
                    G[:g, :g], G[:g, g:r], G[:g, r:-1], h[:g],
                    G[g:r, g:r], G[g:r, r:-1], h[g:r],
                    G[r:-1, r:-1], h[r:-1], h[-1],
                )
            )  # fmt: skip

    def _damp(self, graph: Any, groups: Int, damping: float) -> None:
        root, zero = np.sqrt(damping) * np.eye(6 * _GROUP), np.zeros(6 * _GROUP)
        for group in groups.tolist():
            self._add_rows(graph, group, root, zero)

    def _add_rows(self, graph: Any, key: int, A: Float, b: Float) -> None:
        unit = self._gtsam.noiseModel.Unit.Create(len(A))
        graph.add(self._gtsam.JacobianFactor(key, A, b, unit))


def _append(net: Any, more: Any) -> None:
    """Append the conditionals of one GTSAM Bayes net to another."""
    for k in range(more.size()):
        net.push_back(more.at(k))
