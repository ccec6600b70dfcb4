"""Pose graph of sub-maps on Sim(3) or SL(4) with loops, by GTSAM."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from bench.baselines.overlap import BaselineError
from bench.baselines.sl4 import special
from calm_edge.geometry.similarity import Similarity
from calm_edge.types import Float

# Sigma of all components of a relative transform's error (tangent vector) in VGGT-SLAM. VGGT-Long,
# too, gives all edges and components equal weight.
SIGMA = 0.05
_HELD = 1e-6


@dataclass(frozen=True, slots=True)
class Tie:
    """Measured relative transform T_previous_new (4, 4) of two sub-maps, given by index."""

    previous: int
    new: int
    T_previous_new: Float


def optimise(
    group: Literal["sim3", "sl4"], T_w_s: Float, ties: Sequence[Tie], loops: Sequence[Tie]
) -> Float:
    """Optimise T_w_s (S, 4, 4) of all sub-maps with the first one fixed; raises BaselineError.

    T_w_s: initial values. ties: between consecutive sub-maps. There is no robust kernel, as in the
    publications: one would reject the true loop of a long drive. Lengths are divided by the median
    distance between the origins of consecutive sub-maps, so that the weight of translation against
    rotation does not depend on the unit.
    """
    import gtsam

    steps = [np.linalg.norm(tie.T_previous_new[:3, 3] / tie.T_previous_new[3, 3]) for tie in ties]
    length = float(np.median(steps)) or 1.0
    shrink = np.diag([1 / length] * 3 + [1.0])
    grow = np.diag([length] * 3 + [1.0])
    element = _similarity if group == "sim3" else _homography
    between = gtsam.BetweenFactorSimilarity3 if group == "sim3" else gtsam.BetweenFactorSL4
    prior = gtsam.PriorFactorSimilarity3 if group == "sim3" else gtsam.PriorFactorSL4
    noise = gtsam.noiseModel.Isotropic.Sigma(7 if group == "sim3" else 15, SIGMA)
    held = gtsam.noiseModel.Isotropic.Sigma(noise.dim(), _HELD)
    try:
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        first = np.linalg.inv(T_w_s[0])
        for k, T in enumerate(T_w_s):
            values.insert(k, element(shrink @ first @ T @ grow))
        graph.add(prior(0, element(np.eye(4)), held))
        for tie in (*ties, *loops):
            measured = element(shrink @ tie.T_previous_new @ grow)
            graph.add(between(tie.previous, tie.new, measured, noise))
        best = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
        at = best.atSimilarity3 if group == "sim3" else best.atSL4
        T = np.stack([at(k).matrix() for k in range(len(T_w_s))])
    except (RuntimeError, ValueError, np.linalg.LinAlgError) as error:
        raise BaselineError(f"the pose graph failed: {' '.join(str(error).split())}") from None
    # gtsam's similarity matrix is [[R, t], [0, 1 / scale]]
    T = T_w_s[0] @ grow @ (T / T[:, 3:, 3:] if group == "sim3" else T) @ shrink
    if not np.isfinite(T).all():
        raise BaselineError("the pose graph's result is not finite")
    return np.asarray(T)


def _similarity(T: Float) -> Any:
    import gtsam

    if not (np.isfinite(T).all() and np.linalg.det(T[:3, :3]) > 0):
        raise BaselineError("a transform given to the pose graph is not a similarity")
    s = Similarity.from_matrix(T)
    # gtsam.Similarity3 maps p to scale (R p + t)
    return gtsam.Similarity3(gtsam.Rot3(s.R), s.t / s.scale, s.scale)


def _homography(T: Float) -> Any:
    import gtsam

    return gtsam.SL4(special(T))
