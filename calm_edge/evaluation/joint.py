"""Error of several drives in one frame, against true poses that are in one frame too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calm_edge.evaluation import EvaluationError, trajectory
from calm_edge.evaluation.estimate import Estimate
from calm_edge.evaluation.results import MIN_POSES, Alignment, choose, common_origin
from calm_edge.evaluation.truth import Truth
from calm_edge.geometry.similarity import align

# poses this near the identity begin a truth that has a frame of its own, as KITTI's do
_ORIGIN = 1e-6


@dataclass(frozen=True, slots=True)
class JointError:
    """RMS distances [m] of positions to the true ones: of all, and of each drive.

    alignment: kind of the motion, one for all.
    """

    alignment: Alignment
    ate_m: float
    by_drive: tuple[float, ...]


def joint_error(drives: Sequence[tuple[Estimate, Truth]]) -> JointError:
    """Compare drives in one frame with the truth of each.

    Raises EvaluationError if a drive has no true poses, or if several truths begin at the origin,
    so that how they lie to each other is not known.
    """
    own = [truth for _, truth in drives if _begins_at_origin(truth)]
    if len(own) > 1:
        raise EvaluationError(
            "the true poses of several drives begin at the origin, each in a frame of its own; "
            "write them in one frame"
        )
    found, true = [], []
    for estimate, truth in drives:
        t_ns = common_origin(estimate.t_ns, truth.t_ns, estimate.first_frame)
        i, j = trajectory.associate(t_ns, truth.t_ns)
        if len(i) < MIN_POSES:
            raise EvaluationError(f"{estimate.source}: has no true poses at its times")
        found.append(estimate.T_w_c[i, :3, 3])
        true.append(truth.T_w_c[j, :3, 3])
    p, p_true = np.concatenate(found), np.concatenate(true)
    # lengths of the map are those of the first drive
    chosen = choose(drives[0][0])
    motion = align(p, p_true, with_scale=chosen == "sim3")
    each = tuple(trajectory.ate(motion.points(a), b) for a, b in zip(found, true, strict=True))
    return JointError(chosen, trajectory.ate(motion.points(p), p_true), each)


def _begins_at_origin(truth: Truth) -> bool:
    return len(truth.T_w_c) > 0 and bool(np.abs(truth.T_w_c[0] - np.eye(4)).max() < _ORIGIN)
