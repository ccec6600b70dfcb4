"""The primary-assistant joint pose graph (paper IV-C): what was measured, and its best poses.

State: the primary keyframes and T_p_a; the assistant's trajectory is T_w_p T_p_a throughout.
Variances are the paper's numbers taken in map units (spacings) and radians: the paper states
them in its first sub-map's own unit, and without loops only their ratios matter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calm_edge.config import PoseGraphConfig
from calm_edge.geometry import se3
from calm_edge.posegraph.levenberg_marquardt import minimise
from calm_edge.posegraph.problem import Edges, Problem, State, cauchy, cost, huber, residuals
from calm_edge.types import Float, Int, LoopClosure

# A bridge is a guess at motion nobody measured: ten times an odometry edge's sigma.
_BRIDGE_WEIGHT = 0.01
# How far the convex pass goes: until it moves the cost by less than this share.
_COARSE = 1e-3


@dataclass(frozen=True, slots=True)
class Optimised:
    """What a run of the optimiser did. Costs: half squared Mahalanobis distances."""

    iterations: int
    cost_before: float
    cost_after: float


class JointGraph:
    """Owns the keyframe poses in the world and every relative measurement of them.

    spacing: world units a map unit.
    """

    def __init__(self, config: PoseGraphConfig, spacing: float = 1.0) -> None:
        self._config = config
        self._spacing = spacing
        self._row: dict[int, int] = {}
        self._T_w_p: list[Float] = []
        self._edges: list[Edges] = []
        self._n_submaps = 0
        self._T_p_a_prior: Float | None = None
        self._T_p_a: Float = np.eye(4)

    def __contains__(self, keyframe_id: int) -> bool:
        return keyframe_id in self._row

    def __len__(self) -> int:
        return len(self._row)

    @property
    def keyframe_ids(self) -> Int:
        """(N,) in the order they were added."""
        return np.fromiter(self._row, np.int64, len(self._row))

    @property
    def T_p_a(self) -> Float:
        """(4, 4) assistant->primary, world units."""
        return self._T_p_a

    def poses(self) -> Float:
        """T_w_p (N, 4, 4) in the order of keyframe_ids, world units."""
        return np.array(self._T_w_p).reshape(-1, 4, 4)

    def pose(self, keyframe_id: int) -> Float:
        """T_w_p (4, 4) of one keyframe."""
        return self._T_w_p[self._row[keyframe_id]]

    def set_rig_prior(self, T_p_a: Float) -> None:
        """E_prior: anchors T_p_a (4, 4) to the first sub-map's average."""
        self._T_p_a_prior = self._T_p_a = T_p_a

    def add_submap(
        self, ids: tuple[int, ...], T_w_s: Float, T_s_p: Float, T_s_a: Float, seen: Int
    ) -> None:
        """E_pri and E_ast of each keyframe against its `window` predecessors in the sub-map.

        ids: keyframe of each T_s_p (N, 4, 4). T_s_a: (V, 4, 4) the assistant at the stamps of
        the primary views `seen` (V,). World units, rectified. Keyframes already known keep
        their pose, the first sub-map's; a pair that two sub-maps saw was measured twice.
        """
        for keyframe_id, T in zip(ids, T_w_s @ T_s_p, strict=True):
            if keyframe_id not in self._row:
                self._row[keyframe_id] = len(self._T_w_p)
                self._T_w_p.append(T)
        i, j = _preceding(len(ids), self._config.window)
        if not len(i):
            return
        rows = np.array([self._row[keyframe_id] for keyframe_id in ids])
        T_s_a_all = np.tile(np.eye(4), (len(ids), 1, 1))
        T_s_a_all[seen] = T_s_a
        has_assistant = np.isin(np.arange(len(ids)), seen)
        self._edges.append(
            Edges(
                i=rows[i],
                j=rows[j],
                T_j_i=se3.inverse(T_s_p[j]) @ T_s_p[i],
                T_j_i_assistant=se3.inverse(T_s_a_all[j]) @ T_s_a_all[i],
                weight=np.ones(len(i)),
                weight_assistant=(has_assistant[i] & has_assistant[j]).astype(np.float64),
                robust=np.zeros(len(i), bool),
                submap=np.full(len(i), self._n_submaps),
            )
        )
        self._n_submaps += 1

    def add_bridge(self, before_id: int, after_id: int) -> None:
        """Ties two keyframes with nothing measured between them, loosely, where they now are."""
        T_j_i = se3.inverse(self.pose(before_id)) @ self.pose(after_id)
        self._add_single(before_id, after_id, T_j_i, _BRIDGE_WEIGHT, robust=False)

    def add_loop(self, loop: LoopClosure) -> None:
        """E_loop, with a robust kernel; KeyError where a keyframe is not in the graph."""
        self._add_single(loop.match_id, loop.query_id, loop.T_match_query, 1.0, robust=True)

    def _add_single(
        self, j_id: int, i_id: int, T_j_i: Float, weight: float, *, robust: bool
    ) -> None:
        self._edges.append(
            Edges(
                i=np.array([self._row[i_id]]),
                j=np.array([self._row[j_id]]),
                T_j_i=T_j_i[None],
                T_j_i_assistant=np.eye(4)[None],
                weight=np.array([weight]),
                weight_assistant=np.zeros(1),
                robust=np.array([robust]),
                submap=np.array([-1]),
            )
        )

    def problem(self) -> Problem:
        """Everything measured so far, with its noise in world units; needs one pair and a prior."""
        if self._T_p_a_prior is None:
            raise ValueError("set_rig_prior comes before problem and optimise")
        config = self._config
        unit = np.repeat([self._spacing, 1.0], 3)
        variance = np.repeat([config.translation_variance, config.rotation_variance], 3)
        fields = {
            name: np.concatenate([getattr(edges, name) for edges in self._edges])
            for name in Edges.__slots__
        }
        return Problem(
            edges=Edges(**fields),
            T_p_a_prior=self._T_p_a_prior,
            sigma=np.sqrt(variance) * unit,
            sigma_prior=np.sqrt(config.rig_prior_variance) * unit,
        )

    def optimise(self, tolerance: float = 1e-6) -> Optimised:
        """Moves every pose and T_p_a to the optimum; the first keyframe stays where it is.

        tolerance: it ends when an iteration lowers the cost by less than this share.
        With loops there are two ways down: at once, which leaves out what contradicts the poses
        so far, and after a convex kernel, by which a true loop closes however far the drift. The
        lower of the two ends is kept: a false loop bends the path at a cost.
        """
        if not self._edges:
            return Optimised(0, 0.0, 0.0)
        problem, start = self.problem(), State(self.poses(), self._T_p_a)
        before = cost(problem, residuals(problem, start), cauchy)
        state, iterations = minimise(problem, start, cauchy, tolerance)
        after = cost(problem, residuals(problem, state), cauchy)
        if problem.edges.robust.any():
            pulled, coarse = minimise(problem, start, huber, _COARSE)
            pulled, fine = minimise(problem, pulled, cauchy, tolerance)
            iterations += coarse + fine
            if (pulled_cost := cost(problem, residuals(problem, pulled), cauchy)) < after:
                state, after = pulled, pulled_cost
        self._T_w_p, self._T_p_a = list(state.T_w_p), state.T_p_a
        return Optimised(iterations, before, after)


def _preceding(n: int, window: int) -> tuple[Int, Int]:
    """Pairs (i, j) of n views, each view i with its `window` predecessors j."""
    i, j = np.nonzero(np.tri(n, k=-1) - np.tri(n, k=-window - 1))
    return i, j
