"""Noise of the odometry edges, estimated from keyframe pairs that lie in two sub-maps.

The paper's variances (IV-C) only set the relative weights of measurements. Two sub-maps that
share keyframes measure the same motion with independent errors; their differences give the
actual variance of a backbone.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from calm_edge.geometry import se3
from calm_edge.posegraph.problem import Edges, Problem
from calm_edge.types import Float, Int


class Noise(NamedTuple):
    """Sigmas of a view's pose in its sub-map, per axis (world units, rad), and of a sub-map's
    log scale.
    """

    translation: float
    rotation: float
    scale: float

    def view_covariance(self) -> Float:
        """Covariance (6, 6) of a view's pose, (translation, rotation) in its own axes."""
        return np.diag(np.repeat(np.square([self.translation, self.rotation]), 3))


def measured_twice(edges: Edges) -> tuple[Int, Int]:
    """Find pairs of keyframes measured by two consecutive sub-maps: edge indices (R,), (R,)."""
    order = np.lexsort((edges.submap, edges.j, edges.i))
    order = order[edges.submap[order] >= 0]
    first, second = order[:-1], order[1:]
    same = (edges.i[first] == edges.i[second]) & (edges.j[first] == edges.j[second])
    return first[same], second[same]


def measured_noise(problem: Problem) -> Noise | None:
    """Noise from the differences of edges measured twice, of both cameras; None without any.

    Two measurements involve four views with independent errors, so a difference has 4 times the
    variance of a view. Where the later sub-map was drawn to the earlier one, the difference is
    taken as it was before, so that the noise is that of sub-maps solved alone: over a drive, errors
    that neighbours share add up to those of independent ones. A difference of translations also
    contains, perpendicular to the motion, the rotation errors of the two earlier views times the
    distance, and along the motion the scale errors of the two sub-maps. The scale sigma is at least
    `problem.scale_sigma`.
    """
    edges = problem.edges
    first, second = measured_twice(edges)
    seen = edges.weight_assistant[first] * edges.weight_assistant[second] > 0
    A = np.concatenate([edges.T_j_i[first], edges.T_j_i_assistant[first[seen]]])
    B = np.concatenate([edges.T_j_i[second], edges.T_j_i_assistant[second[seen]]])
    if not len(A):
        return None
    later = np.concatenate([edges.submap[second], edges.submap[second][seen]])
    drawn = problem.drawn[later]
    difference = (B[:, :3, 3] - A[:, :3, 3]) / drawn[:, :1]
    length2 = np.maximum((A[:, :3, 3] ** 2).sum(-1), 1e-12)
    along = ((difference * A[:, :3, 3]).sum(-1) ** 2 / length2).mean()
    across = max((difference**2).sum(-1).mean() - along, 0.0) / 2
    rotation = ((se3.log(se3.inverse(A) @ B)[:, 3:] / drawn[:, 1:]) ** 2).mean() / 4
    lever = 2 * rotation * length2.mean()
    # if the rotation errors explain all of `across`, attribute a tenth of it to translation
    translation = max(across - lever, across / 10) / 4
    excess = along - 4 * translation
    # Take the scale error as zero unless significant: two standard errors of a mean square. Pairs
    # of one overlap share views, so a third of them is counted as independent.
    if excess < 2 * along * np.sqrt(2 * 3 / len(A)):
        excess = 0.0
    scale = max(excess / (2 * length2.mean()), problem.scale_sigma**2)
    return Noise(*np.sqrt([translation, rotation, scale]).tolist())


def assumed_noise(problem: Problem) -> Noise:
    """Noise from the configured variances, if not measurable; a view has half that of a pair."""
    translation, rotation = problem.sigma[[0, -1]] / np.sqrt(2)
    return Noise(float(translation), float(rotation), problem.scale_sigma)
