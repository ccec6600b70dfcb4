"""End of a run: how long it may take, and the sub-maps in their final places."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calm_edge.daemon.messages import Finished
from calm_edge.types import KitBelief, LocalizerUpdate, Prediction, Trajectory

REPLAY_LIMIT_S = 900.0
LIVE_LIMIT_S = 20.0


def final_updates(finished: Finished, kit: KitBelief | None) -> Iterator[LocalizerUpdate]:
    """One update for each sub-map after the joint optimum, with poses only.

    Only the last one has the whole trajectory: in each, it would take more room than the images of
    a long drive. `map` takes the landmarks from the sub-map's first update.
    """
    trajectory = finished.trajectory
    if trajectory is None:
        return
    for submap in finished.submaps:
        last = submap is finished.submaps[-1]
        mine = np.isin(trajectory.keyframe_ids, submap.primary_ids) | last
        yield LocalizerUpdate(
            submap,
            Prediction(submap.cameras_raw, submap.T_s_c_raw),
            Trajectory(
                trajectory.keyframe_ids[mine],
                trajectory.t_ns[mine],
                trajectory.T_w_c[mine],
                trajectory.T_p_a,
                trajectory.epoch,
            ),
            kit=kit,
        )
