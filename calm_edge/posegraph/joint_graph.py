"""The primary-assistant joint pose graph (paper IV-C): relative measurements and keyframe poses.

State: poses of the primary keyframes and T_p_a; assistant poses are always T_w_p T_p_a.
The variances have the values of the paper, but in map units (camera spacings) and rad, whereas the
paper has them in the unit of its first sub-map. Without loops only their ratios matter.
"""

from __future__ import annotations

from itertools import count

import numpy as np

from calm_edge.config import PoseGraphConfig
from calm_edge.geometry import se3
from calm_edge.posegraph.optimiser import Snapshot, Solved
from calm_edge.posegraph.problem import Edges, Problem, State, joined
from calm_edge.types import Float, Int, LoopClosure

# Most information of a bridge (see `add_bridge`) relative to an odometry edge: ten times the sigma.
_BRIDGE_WEIGHT = 0.01
_KEYS = count()


class JointGraph:
    """Collects relative measurements between keyframes, and holds the keyframe poses.

    spacing: world units per map unit.
    """

    def __init__(self, config: PoseGraphConfig, spacing: float = 1.0) -> None:
        self._key = next(_KEYS)
        self._config = config
        self._spacing = spacing
        self._row: dict[int, int] = {}
        self._T_w_p: list[Float] = []
        self._edges: list[Edges] = []
        self._n_submaps = 0
        self._drawn: list[Float] = []
        self._scale_variance = 0.0
        self._T_p_a_prior: Float | None = None
        self._T_p_a: Float = np.eye(4)

    def __contains__(self, keyframe_id: int) -> bool:
        return keyframe_id in self._row

    def __len__(self) -> int:
        return len(self._row)

    @property
    def keyframe_ids(self) -> Int:
        """Ids (N,) of the keyframes in the order of insertion."""
        return np.fromiter(self._row, np.int64, len(self._row))

    @property
    def T_p_a(self) -> Float:
        """Rig transform (4, 4), assistant to primary camera, world units."""
        return self._T_p_a

    def poses(self) -> Float:
        """Poses T_w_p (N, 4, 4) in the order of keyframe_ids, world units."""
        return np.array(self._T_w_p).reshape(-1, 4, 4)

    def pose(self, keyframe_id: int) -> Float:
        """Pose T_w_p (4, 4) of a keyframe. Raises KeyError for an unknown id."""
        return self._T_w_p[self._row[keyframe_id]]

    def state(self) -> State:
        """Current estimate of all poses and of T_p_a."""
        return State(self.poses(), self._T_p_a)

    def set_rig_prior(self, T_p_a: Float) -> None:
        """Set the prior on the rig (E_prior of IV-C): T_p_a (4, 4), the first sub-map's mean."""
        self._T_p_a_prior = self._T_p_a = T_p_a

    def add_submap(
        self,
        ids: tuple[int, ...],
        T_w_s: Float,
        T_s_p: Float,
        T_s_a: Float,
        seen: Int,
        drawn: Float | None = None,
        cuts: tuple[int, ...] = (),
    ) -> None:
        """Add a sub-map's measurements between each keyframe and its `window` predecessors.

        Of both cameras (E_pri, E_ast of IV-C). ids: keyframe ids of T_s_p (N, 4, 4). T_s_a: (V, 4,
        4) assistant poses interpolated to the stamps of the primary views with index `seen` (V,).
        All rectified, world units. A keyframe that is in the graph already keeps its pose; a pair
        of keyframes that lies in two sub-maps gets an edge from each. drawn: (2,) `Submap.drawn`.
        cuts: `Submap.cuts`; pairs on both sides of one get no edge.
        """
        for keyframe_id, T in zip(ids, T_w_s @ T_s_p, strict=True):
            if keyframe_id not in self._row:
                self._row[keyframe_id] = len(self._T_w_p)
                self._T_w_p.append(T)
        i, j = _preceding(len(ids), self._config.window)
        part = np.searchsorted(cuts, np.arange(len(ids)), side="right")
        i, j = i[part[i] == part[j]], j[part[i] == part[j]]
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
        self._drawn.append(np.ones(2) if drawn is None else drawn)
        self._scale_variance += _scale_variance(T_s_p[seen], T_s_a)

    def add_bridge(
        self, before_id: int, after_id: int, translation: float = 0.0, rotation: float = 0.0
    ) -> None:
        """Add a weak edge with the current relative pose of two keyframes as measurement.

        It connects the graph across a gap for which no sub-map could be reconstructed. translation,
        rotation: its sigmas, world units and rad; never less than ten times an odometry edge's.
        """
        T_j_i = se3.inverse(self.pose(before_id)) @ self.pose(after_id)
        config = self._config
        ratio2 = max(
            (translation / self._spacing) ** 2 / config.translation_variance,
            rotation**2 / config.rotation_variance,
        )
        weight = min(_BRIDGE_WEIGHT, 1 / ratio2 if ratio2 else np.inf)
        self._add_single(before_id, after_id, T_j_i, weight, robust=False)

    def add_loop(self, loop: LoopClosure) -> None:
        """Add a loop closure (E_loop), under a robust kernel.

        Raises KeyError for a keyframe not in the graph.
        """
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
        """All measurements and their noise in world units.

        Raises ValueError without a rig prior or without any edge.
        """
        if self._T_p_a_prior is None:
            raise ValueError("call set_rig_prior before problem")
        config = self._config
        unit = np.repeat([self._spacing, 1.0], 3)
        variance = np.repeat([config.translation_variance, config.rotation_variance], 3)
        return Problem(
            edges=joined(self._edges),
            T_p_a_prior=self._T_p_a_prior,
            sigma=np.sqrt(variance) * unit,
            sigma_prior=np.sqrt(config.rig_prior_variance) * unit,
            spacing=self._spacing,
            scale_sigma=float(np.sqrt(self._scale_variance / max(self._n_submaps, 1))),
            drawn=np.array(self._drawn).reshape(-1, 2),
        )

    def snapshot(self) -> Snapshot | None:
        """Copy of problem and state for an optimiser; None while the graph has no edge."""
        return Snapshot(self._key, self.problem(), self.state()) if self._edges else None

    def apply(self, solved: Solved) -> bool:
        """Set all poses to the optimum of an earlier snapshot; False if it is of another graph.

        Keyframes added after the snapshot move rigidly with the last optimised one.
        """
        if solved.graph != self._key:
            return False
        T_w_p, self._T_p_a = solved.optimum.state
        n = len(T_w_p)
        moved = T_w_p[-1] @ se3.inverse(self._T_w_p[n - 1])
        self._T_w_p = [*T_w_p, *(moved @ T for T in self._T_w_p[n:])]
        return True


def _preceding(n: int, window: int) -> tuple[Int, Int]:
    """Index pairs (i, j) of n views: each view i with its up to `window` predecessors j."""
    i, j = np.nonzero(np.tri(n, k=-1) - np.tri(n, k=-window - 1))
    return i, j


def _scale_variance(T_s_p: Float, T_s_a: Float) -> float:
    """Variance of a sub-map's log scale: relative variance of the mean of its V camera spacings."""
    spacing = np.linalg.norm((T_s_a - T_s_p)[:, :3, 3], axis=-1)
    if len(spacing) < 2:
        return 0.0
    return float(spacing.var(ddof=1) / len(spacing) / spacing.mean() ** 2)
