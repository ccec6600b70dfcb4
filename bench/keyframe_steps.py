"""Steps between consecutive keyframes of a recording against the true ones."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calm_edge.evaluation import EvaluationError
from calm_edge.evaluation.trajectory import associate
from calm_edge.evaluation.truth import Truth
from calm_edge.recording.reader import Recording
from calm_edge.trajectories import folded
from calm_edge.types import METRIC_LOG_SIGMA, Float, Int
from device.frame import Eye

# A step, the distance between consecutive keyframes, is garbage if the log of its ratio to the true
# one differs by more than this from the median over the drive.
GARBAGE_LOG = 0.18
# With a shorter true step the car counts as standing, and the step is not judged, m.
STANDING_M = 0.02


class Steps(NamedTuple):
    """What became of the primary keyframes of a drive.

    placed: share of them in a sub-map. The others are reported as lost, or bridged by constant
    velocity. garbage: share of garbage among the steps within sub-maps. metric, garbage_of_metric:
    the same of the sub-maps that are reported as metric alone.
    """

    placed: float
    garbage: float
    metric: float
    garbage_of_metric: float


def judged(recording: Path, truth: Truth) -> Steps:
    """Judge the keyframes of a recording by the true poses; raises EvaluationError without any."""
    source = Recording(recording)
    updates = list(source.updates())
    trajectory = folded(update.trajectory for update in updates)
    if trajectory is None:
        raise EvaluationError(f"{recording}: no keyframe was placed")
    keyframes = {
        int(i)
        for window in source.windows()
        for i, eye in zip(window.ids, window.eyes, strict=True)
        if eye == Eye.PRIMARY
    }
    i, j = associate(trajectory.t_ns, truth.t_ns)
    ids, T_w_c = trajectory.keyframe_ids[i], trajectory.T_w_c[i]
    step = np.linalg.norm(np.diff(T_w_c[:, :3, 3], axis=0), axis=1)
    true = np.linalg.norm(np.diff(truth.T_w_c[j, :3, 3], axis=0), axis=1)
    submaps = {update.submap.id: update.submap for update in updates}
    every = [submap.primary_ids for submap in submaps.values()]
    metric = [s.primary_ids for s in submaps.values() if s.scale_log_sigma <= METRIC_LOG_SIGMA]
    placed = keyframes.intersection(trajectory.keyframe_ids.tolist())
    n = max(len(keyframes), 1)
    together, of_metric = within_submap(ids, every), within_submap(ids, metric)
    return Steps(
        len(placed) / n,
        garbage_share(step[together], true[together]),
        len(placed.intersection(i for members in metric for i in members)) / n,
        garbage_share(step[of_metric], true[of_metric]),
    )


def within_submap(ids: Int, submaps: Iterable[Sequence[int]]) -> NDArray[np.bool_]:
    """Whether ids (N,) of consecutive poses share a sub-map, pair by pair (N - 1,).

    A step between keyframes that no sub-map holds together is a bridge, not a measurement.
    """
    out = np.zeros(max(len(ids) - 1, 0), bool)
    for members in submaps:
        held = np.isin(ids, list(members))
        out |= held[:-1] & held[1:]
    return out


def garbage_share(step: Float, true: Float) -> float:
    """Share of garbage (GARBAGE_LOG) among steps (N,), those where the car stands left out.

    step, true: estimated and true distances between consecutive keyframes, m. 0 if the car never
    moves.
    """
    moving = true > STANDING_M
    if not moving.any():
        return 0.0
    ratio = np.log(np.maximum(step[moving], 1e-9) / true[moving])
    return float((np.abs(ratio - np.median(ratio)) > GARBAGE_LOG).mean())
