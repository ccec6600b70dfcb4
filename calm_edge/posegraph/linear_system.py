"""The normal equations of the joint graph, and GTSAM's elimination of them (paper IV-C).

Every residual is linearised exactly in one numpy pass, with numpy's own tangent, so that
GTSAM's order of rotation and translation never enters. Each call from Python costs, so
neighbouring keyframes share one GTSAM variable, a *group*, and all that joins a group to the
next is one factor.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from calm_edge.geometry import se3
from calm_edge.posegraph import assistant_factor
from calm_edge.posegraph.problem import Edges, Kernel, Problem, Residuals, State, softening
from calm_edge.types import Float, Int

# Keyframes a group: just wide enough for a window of 3 to reach no further than the next group.
_GROUP = 3
# Pairs linearised at once: what they need stays in the processor's cache and out of its memory.
_CHUNK = 256


class Rows(NamedTuple):
    """Whitened derivatives (P, 12, 6) by the poses i, j and by T_p_a, and -residuals b (P, 12).

    The first six rows are the primary's, the others the assistant's.
    """

    by_i: Float
    by_j: Float
    by_rig: Float
    b: Float


def linearise(problem: Problem, state: State, r: Residuals, soft: Float, pairs: Int) -> Rows:
    """Some pairs (Q,) of the edges at `state`, where residuals are `r`.

    soft: (P,) factors on the primary's inverse variances, of `softening`.
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
    """Where each pair's block goes; depends on the pairs' ends alone.

    Keyframes are padded to whole groups, two at least. A factor joins the groups low (F,) and
    high (F,): each neighbouring pair first, then each that only a loop joins. Within a factor
    a pose has six columns, low's poses first, then T_p_a, then b.
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
        # groups that a loop joins to more than their neighbours
        self.looped = np.zeros(self.n_groups, bool)
        self.looped[self.low[len(near) :]] = self.looped[self.high[len(near) :]] = True
        self._order = np.argsort(factor_of, kind="stable")
        self._factor = factor_of[self._order]
        ends = np.stack([edges.i, edges.j], -1)[self._order]
        is_low = ends // _GROUP == self.low[self._factor][:, None]
        column = 6 * (ends % _GROUP + np.where(is_low, 0, _GROUP))
        # each end's six columns, then those of T_p_a and of b
        both = (column[..., None] + np.arange(6)).reshape(-1, 12)
        rest = np.broadcast_to(12 * _GROUP + np.arange(7), (len(both), 7))
        self._columns = np.concatenate([both, rest], 1)

    def complete(self, n_factors: int) -> int:
        """How many groups, from the first, are joined to their neighbours by the first factors."""
        return self.n_groups if n_factors >= self.n_groups - 1 else n_factors

    def chunks(self) -> Iterator[tuple[slice, Int, Int, Int]]:
        """(factors, pairs (Q,), factor of each counted in the slice (Q,), columns (Q, 19))."""
        cuts = np.searchsorted(self._factor, self._factor[::_CHUNK])
        cuts = np.unique(np.append(cuts, len(self._factor)))
        for start, end in pairwise(cuts.tolist()):
            first, last = int(self._factor[start]), int(self._factor[end - 1])
            pairs, columns = self._order[start:end], self._columns[start:end]
            yield slice(first, last + 1), pairs, self._factor[start:end] - first, columns


def _blocks(rows: Rows, factor: Int, columns: Int, n_factors: int) -> Float:
    """(F, D, D) sums of A^T A of the pairs, b the last column: D = 12 poses' and 7 more."""
    A = np.concatenate([rows.by_i, rows.by_j, rows.by_rig, rows.b[..., None]], -1)
    D = 12 * _GROUP + 7
    index = (factor[:, None, None] * D + columns[:, :, None]) * D + columns[:, None, :]
    # a copy: of one and the same buffer numpy computes half a product, three times slower
    products = np.swapaxes(A, -1, -2) @ A.copy()
    summed = np.bincount(index.ravel(), products.ravel(), n_factors * D * D)
    return np.asarray(summed.reshape(n_factors, D, D))


class LinearSystem:
    """The problem linearised at a state: GTSAM keys are the groups, T_p_a the last.

    A group is eliminated as soon as all that joins it to others is there, so of a long drive no
    more is ever held than back-substitution needs. Groups at the ends of loops come last.
    """

    def __init__(
        self, problem: Problem, state: State, r: Residuals, kernel: Kernel, layout: Layout
    ) -> None:
        import gtsam

        self._gtsam: Any = gtsam
        self._problem, self._state, self._r, self._layout = problem, state, r, layout
        self._soft = softening(problem, r, kernel)
        self._rig = layout.n_groups

    def solve(self, damping: float) -> Float | None:
        """Steps (N + 1, 6) of the damped normal equations, that of T_p_a last.

        None where they are not positive definite: a path of kilometres, hardly damped, can lose
        that to rounding.
        """
        gtsam, layout = self._gtsam, self._layout
        graph, net, done = gtsam.GaussianFactorGraph(), gtsam.GaussianBayesNet(), 0
        self._hold(graph, damping)
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
            # T_p_a touches every keyframe: eliminated last, the rest stays a narrow band
            ordering = gtsam.Ordering.ColamdConstrainedLastGaussianFactorGraph(graph, [self._rig])
            _append(net, graph.eliminateSequential(ordering))
            solution = net.optimize()
        except RuntimeError:
            return None
        steps = np.asarray(solution.vector(list(range(self._rig + 1)))).reshape(-1, 6)
        return np.concatenate([steps[: layout.n], steps[-1:]])

    def _hold(self, graph: Any, damping: float) -> None:
        """The prior on T_p_a, the gauge, and rows that no keyframe has."""
        problem, r = self._problem, self._r
        J = se3.right_jacobian_inverse(r.prior) / problem.sigma_prior[:, None]
        self._add_rows(graph, self._rig, J, -r.prior / problem.sigma_prior)
        self._add_rows(graph, self._rig, np.sqrt(damping) * np.eye(6), np.zeros(6))
        # without the gauge the whole world may move at no cost, so any weight holds exactly
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
        """Adds factors, their blocks in H (F, D, D)."""
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
    """Conditionals of one GTSAM Bayes net, after those of another."""
    for k in range(more.size()):
        net.push_back(more.at(k))
