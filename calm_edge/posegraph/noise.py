"""What the measurements say of their own noise: pairs of views that two sub-maps both saw.

The paper's variances weigh one measurement against another; they are not the error of any
backbone. Two sub-maps that share keyframes measure the same motion twice, with errors of their
own: how far they disagree is the error.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from calm_edge.geometry import se3
from calm_edge.posegraph.problem import Edges, Problem
from calm_edge.types import Float, Int


class Noise(NamedTuple):
    """One sigma, per axis, of a view's pose in its sub-map (world units, rad), and of the log
    scale of a sub-map.
    """

    translation: float
    rotation: float
    scale: float

    def view_covariance(self) -> Float:
        """(6, 6) of (translation, rotation), the view's own axes."""
        return np.diag(np.repeat(np.square([self.translation, self.rotation]), 3))


def measured_twice(edges: Edges) -> tuple[Int, Int]:
    """Indices (R,), (R,) of pairs that two sub-maps measured, one after the other."""
    order = np.lexsort((edges.submap, edges.j, edges.i))
    order = order[edges.submap[order] >= 0]
    first, second = order[:-1], order[1:]
    same = (edges.i[first] == edges.i[second]) & (edges.j[first] == edges.j[second])
    return first[same], second[same]


def measured_noise(problem: Problem) -> Noise | None:
    """From the disagreement of both cameras' pairs; None where none was measured twice.

    The errors of the four views of two measurements are taken as independent. A rotation then
    disagrees by 4 times a view's variance. So does a translation, and across the pair's
    direction the rotations of the two earlier views add a lever of its length, along it the
    scales of the two sub-maps. Where the scatter of the spacing says more of scale, it counts.
    """
    edges = problem.edges
    first, second = measured_twice(edges)
    seen = edges.weight_assistant[first] * edges.weight_assistant[second] > 0
    A = np.concatenate([edges.T_j_i[first], edges.T_j_i_assistant[first[seen]]])
    B = np.concatenate([edges.T_j_i[second], edges.T_j_i_assistant[second[seen]]])
    if not len(A):
        return None
    difference = B[:, :3, 3] - A[:, :3, 3]
    length2 = np.maximum((A[:, :3, 3] ** 2).sum(-1), 1e-12)
    along = ((difference * A[:, :3, 3]).sum(-1) ** 2 / length2).mean()
    across = max((difference**2).sum(-1).mean() - along, 0.0) / 2
    rotation = (se3.log(se3.inverse(A) @ B)[:, 3:] ** 2).mean() / 4
    lever = 2 * rotation * length2.mean()
    # where the lever explains all, the rest is below what this can see: a tenth of it
    translation = max(across - lever, across / 10) / 4
    excess = along - 4 * translation
    # two standard errors of a mean square; a hand-over's pairs come in threes that share views
    if excess < 2 * along * np.sqrt(2 * 3 / len(A)):
        excess = 0.0
    scale = max(excess / (2 * length2.mean()), problem.scale_sigma**2)
    return Noise(*np.sqrt([translation, rotation, scale]).tolist())


def assumed_noise(problem: Problem) -> Noise:
    """The paper's variances as if they were the errors of pairs: where nothing better is known."""
    translation, rotation = problem.sigma[[0, -1]] / np.sqrt(2)
    return Noise(float(translation), float(rotation), problem.scale_sigma)
