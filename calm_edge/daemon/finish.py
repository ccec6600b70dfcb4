"""End of a run: its time limits, and the updates that hold the final poses of all sub-maps."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calm_edge.config import Config
from calm_edge.daemon.messages import Finished
from calm_edge.estimator.gaps import described
from calm_edge.types import LocalizerUpdate, Prediction, Trajectory

REPLAY_LIMIT_S = 900.0
LIVE_LIMIT_S = 20.0


def gaps(finished: Finished, config: Config) -> str:
    """One line for the user on the gaps of the path; empty without any."""
    if not finished.gaps or finished.trajectory is None:
        return ""
    start_ns = int(finished.trajectory.t_ns[0])
    return described(finished.gaps, start_ns, metric=bool(config.scale.spacing_m))


def final_updates(finished: Finished) -> Iterator[LocalizerUpdate]:
    """Yield an update per sub-map with its poses of the joint optimum; without depth and landmarks.

    Only the last update holds the whole trajectory, since the recording would grow quadratically
    with the length of the drive; the others hold the keyframes of their sub-map. `calm-edge map`
    takes the landmarks from the first update of a sub-map, unless the last one has some, because
    the window was solved again from its pictures.
    """
    trajectory = finished.trajectory
    if trajectory is None:
        return
    for submap in finished.submaps:
        last = submap is finished.submaps[-1]
        mine = np.isin(trajectory.keyframe_ids, submap.primary_ids) | last
        yield LocalizerUpdate(
            submap,
            finished.solved_again.get(submap.id, Prediction(submap.cameras_raw, submap.T_s_c_raw)),
            Trajectory(
                trajectory.keyframe_ids[mine],
                trajectory.t_ns[mine],
                trajectory.T_w_c[mine],
                trajectory.T_p_a,
                trajectory.epoch,
            ),
            kit=finished.kit,
            metre=finished.metre,
            masks=finished.masks,
        )
