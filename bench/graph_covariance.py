"""Covariances of the final poses of a drive, from the joint graph of its sub-maps."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from calm_edge.config import Config
from calm_edge.estimator.atlas import Atlas
from calm_edge.posegraph.marginals import Marginals
from calm_edge.posegraph.noise import assumed_noise, measured_noise
from calm_edge.posegraph.optimiser import Immediate, Snapshot
from calm_edge.posegraph.problem import State
from calm_edge.types import LoopClosure, Submap, Trajectory


class _Kept(Immediate):
    """Optimiser that stores the graph it has solved, for its covariances."""

    snapshot: Snapshot

    def request(self, snapshot: Snapshot) -> None:
        self.snapshot = snapshot
        super().request(snapshot)


def optimised(
    submaps: Sequence[Submap], config: Config, loops: Iterable[LoopClosure] = ()
) -> tuple[Trajectory, Marginals] | None:
    """Place sub-maps again, optimise their poses jointly, and derive the covariances.

    The rows of the covariances are those of the trajectory. None with fewer than two sub-maps, or
    a graph without edges: nothing is optimised then.
    """
    atlas, optimiser = Atlas(config), _Kept()
    for submap in submaps:
        atlas.add(submap)
    for loop in loops:
        atlas.add_loop(loop)
    atlas.request_optimum(optimiser)
    if not hasattr(optimiser, "snapshot"):
        return None
    atlas.settle(optimiser)
    problem, trajectory = optimiser.snapshot.problem, atlas.trajectory()
    noise = measured_noise(problem) or assumed_noise(problem)
    return trajectory, Marginals(problem, State(trajectory.T_w_c, atlas.T_p_a), noise)
