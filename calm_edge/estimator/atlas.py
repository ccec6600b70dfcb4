"""Placed sub-maps and the pose graph between them (paper IV-B, placement, and IV-C).

A keyframe shared by several sub-maps has its world pose from the first of them; each later one is
placed so that the keyframe has that pose in it too (T_w_f of IV-B).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from calm_edge.config import Config
from calm_edge.estimator import gaps, scale
from calm_edge.geometry import se3
from calm_edge.posegraph.joint_graph import JointGraph
from calm_edge.posegraph.optimiser import Optimiser
from calm_edge.types import Float, Int, LoopClosure, Submap, Trajectory

# [s]: constant velocity over this time says nothing of where another drive begins
APART_S = 1000.0


@dataclass(frozen=True, slots=True)
class SkippedWindow:
    """A window that was not reconstructed. t_ns: (N,) of its primary keyframes."""

    submap_id: int
    reason: str
    t_ns: Int


class Atlas:
    """World poses of all sub-maps and keyframes. epoch: incremented when existing poses move."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._submaps: list[Submap] = []
        self._skipped: list[SkippedWindow] = []
        self._loops: list[LoopClosure] = []
        self._stamps: dict[int, int] = {}
        self._graph = JointGraph(config.posegraph, config.scale.spacing)
        self._acceleration = gaps.acceleration(
            config.scale.spacing, metric=bool(config.scale.spacing_m)
        )
        self.epoch = 0

    def __len__(self) -> int:
        return len(self._submaps)

    def __contains__(self, keyframe_id: int) -> bool:
        return keyframe_id in self._graph

    @property
    def submaps(self) -> tuple[Submap, ...]:
        """All sub-maps with their current poses."""
        return tuple(self._submaps)

    @property
    def skipped(self) -> tuple[SkippedWindow, ...]:
        """Windows that were not reconstructed; the n_overlap of the following sub-map is 0."""
        return tuple(self._skipped)

    def pose(self, keyframe_id: int) -> Float:
        """Pose T_w_p (4, 4) of a primary keyframe; KeyError without one."""
        return self._graph.pose(keyframe_id)

    @property
    def T_p_a(self) -> Float:
        """Newest rig (4, 4), assistant->primary, world units; identity before the first sub-map."""
        if self._submaps and self._submaps[-1].kit_epoch:
            return _own_rig(self._submaps[-1])
        return self._graph.T_p_a

    def skip(self, window: SkippedWindow) -> None:
        """Record a window that was not reconstructed, so that the gap it leaves can be bridged."""
        self._skipped.append(window)

    def unskip(self, submap_id: int) -> None:
        """Forget that a window was skipped, since it has been reconstructed after all."""
        self._skipped[:] = [skipped for skipped in self._skipped if skipped.submap_id != submap_id]

    def add(self, submap: Submap, apart: Float | None = None) -> Submap:
        """Place a sub-map in world units and add its measurements to the graph.

        apart: T_w_s (4, 4) of the first sub-map of another drive; loops alone tie it to the rest.
        """
        graph, ids = self._graph, submap.primary_ids
        self._stamps.update(zip(ids, submap.t_ns[: submap.n_primary].tolist(), strict=True))
        primary, assistant = np.split(_rig_views(submap), [submap.n_primary])
        bridged_s = 0.0
        t_p, t_a = submap.exposed_ns[primary], submap.exposed_ns[assistant]
        T_s_p, T_s_a = submap.T_s_c[primary], submap.T_s_c[assistant]
        common = [view for view, keyframe_id in enumerate(ids) if keyframe_id in graph]
        if common:
            T_w_f = np.stack([graph.pose(ids[view]) for view in common])
            T_w_s = scale.placement(T_w_f, T_s_p[common], self._config.scale.average_placement)
        elif apart is not None:
            T_w_s, bridged_s = apart, APART_S
        else:
            T_w_f, bridged_s = self._bridge(submap)
            T_w_s = scale.placement(T_w_f[None], T_s_p[:1])
        if not len(graph):
            graph.set_rig_prior(_own_rig(submap))
        if submap.kit_epoch:
            # the graph has one rig, that of the first epoch: where the assistant would have been
            T_s_a = T_s_a @ se3.inverse(_own_rig(submap)) @ graph.T_p_a
        seen = scale.resampled(t_a, T_s_a, t_p)
        graph.add_submap(ids, T_w_s, T_s_p, *seen, submap.drawn, submap.cuts)
        placed = replace(submap, n_overlap=len(common), T_w_s=T_w_s, bridged_s=bridged_s)
        before = self._submaps[-1:]
        self._submaps.append(placed)
        for gap in gaps.find([*before, placed], (), self._acceleration):
            graph.add_bridge(gap.before_id, gap.after_id, gap.sigma_translation, gap.sigma_rotation)
        if before and not (common or bridged_s):
            # at standstill
            graph.add_bridge(before[0].primary_ids[-1], ids[0])
        return placed

    @property
    def gaps(self) -> tuple[gaps.Gap, ...]:
        """Gaps of the path that no loop closes."""
        return gaps.find(self._submaps, self._loops, self._acceleration)

    def add_loop(self, loop: LoopClosure) -> None:
        """Add a loop closure to the graph (E_loop, IV-C), once both keyframes have a pose."""
        self._loops.append(loop)
        self._close([loop])

    def _close(self, loops: Iterable[LoopClosure]) -> None:
        for loop in loops:
            if loop.query_id in self._graph and loop.match_id in self._graph:
                self._graph.add_loop(loop)

    def empty(self) -> Atlas:
        """Create an atlas with the same skipped windows and no sub-maps."""
        other = Atlas(self._config)
        other._skipped = self._skipped
        return other

    def become(self, other: Atlas) -> None:
        """Take over the content of another atlas of the same drive, which becomes unusable."""
        self._submaps, self._graph, self._stamps = other._submaps, other._graph, other._stamps
        self._close(self._loops)
        self.epoch += 1

    def request_optimum(self, optimiser: Optimiser) -> None:
        """Request the joint optimum (IV-C) of all measurements so far."""
        snapshot = self._graph.snapshot()
        if snapshot is not None:
            optimiser.request(snapshot)

    def settle(self, optimiser: Optimiser) -> bool:
        """Apply the joint optimum if it was requested and is ready; return whether poses moved."""
        solved = optimiser.poll()
        if solved is None or not self._graph.apply(solved):
            return False
        self._follow()
        return True

    def _follow(self) -> None:
        """Place each sub-map again by the optimised poses of all its keyframes."""
        self.epoch += 1
        alike: dict[int, list[int]] = {}
        for k, submap in enumerate(self._submaps):
            alike.setdefault(submap.n_primary, []).append(k)
        for n, some in alike.items():
            submaps = [self._submaps[k] for k in some]
            T_w_p = np.array([[self._graph.pose(i) for i in s.primary_ids] for s in submaps])
            T_s_p = np.stack([s.T_s_c[:n] for s in submaps])
            T_w_s = scale.placement(T_w_p, T_s_p, average=True)
            for k, submap, T in zip(some, submaps, T_w_s, strict=True):
                # a copy: a view would keep the whole array in memory
                self._submaps[k] = replace(submap, T_w_s=T.copy())

    def trajectory(self) -> Trajectory:
        """All primary keyframes that have a pose, sorted by id."""
        ids = self._graph.keyframe_ids
        order = np.argsort(ids)
        return self._trajectory(ids[order], self._graph.poses()[order])

    def trajectory_of(self, submap: Submap) -> Trajectory:
        """The primary keyframes of one sub-map."""
        ids = np.array(sorted(submap.primary_ids), np.int64)
        return self._trajectory(ids, np.stack([self._graph.pose(int(i)) for i in ids]))

    def _trajectory(self, ids: Int, T_w_c: Float) -> Trajectory:
        t_ns = np.fromiter((self._stamps[int(i)] for i in ids), np.int64, len(ids))
        return Trajectory(ids, t_ns, T_w_c, self.T_p_a, self.epoch)

    def _bridge(self, submap: Submap) -> tuple[Float, float]:
        """Predict T_w_f (4, 4) of a sub-map's first frame if none of its frames has a pose.

        Assumes the velocity of the last two keyframes, except at standstill; returns also for how
        many seconds. A moving car gives a keyframe every max_keyframe_gap_s or sooner; longer gaps
        between the stamps of skipped keyframes are standstill.
        """
        if not self._submaps:
            return np.eye(4), 0.0
        ids = self._submaps[-1].primary_ids[-2:]
        start, end = self._stamps[ids[-1]], int(submap.t_ns[0])
        between = [t for skipped in self._skipped for t in skipped.t_ns if start < t < end]
        waits = np.diff(np.unique([start, *between, end])) * 1e-9
        # twice the limit: a keyframe is the first frame after the limit, so it comes a little later
        moving = waits < 2 * self._config.frontend.max_keyframe_gap_s
        # without a skipped window the tracker was restarted
        moving_s = float(waits[moving].sum() if between else waits.sum())
        T_last = self._graph.pose(ids[-1])
        step_s = (start - self._stamps[ids[0]]) * 1e-9
        if step_s == 0:
            return T_last, moving_s
        step = se3.inverse(self._graph.pose(ids[0])) @ T_last
        return np.asarray(T_last @ se3.exp(se3.log(step) * moving_s / step_s)), moving_s


def _own_rig(submap: Submap) -> Float:
    """Mean T_p_a (4, 4) of a sub-map's views, world units."""
    primary, assistant = np.split(_rig_views(submap), [submap.n_primary])
    t_ns, T = submap.exposed_ns, submap.T_s_c
    return se3.mean(scale.rig_samples(t_ns[primary], T[primary], t_ns[assistant], T[assistant]))


def _rig_views(submap: Submap) -> Int:
    """Batch indices of primary and assistant keyframes, without the loop keyframe."""
    return np.arange(submap.n_primary + len(submap.assistant_ids))
