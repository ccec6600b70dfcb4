"""One position a global anchor, and which anchors may steer the map (paper VI-C)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calm_edge.geometry import se3
from calm_edge.types import AnchorTable, Float, GlobalAnchors, Int, Submap

# an anchor at the optical centre itself would weigh infinitely, world units^2
MIN_DISTANCE2 = 1e-6


@dataclass(frozen=True, slots=True)
class Fusion:
    """Running sums over sub-maps, by anchor id.

    weighted: (A, 3) sum of w p_w. weight: (A,) sum of w, 1/world units^2. n: (A,) sub-maps.
    """

    weighted: Float
    weight: Float
    n: Int


def nothing() -> Fusion:
    """No anchor observed yet."""
    return Fusion(np.zeros((0, 3)), np.zeros(0), np.zeros(0, np.int64))


def central_centre(submap: Submap) -> Float:
    """(3,) optical centre of the central primary keyframe, sub-map frame, world units."""
    return np.asarray(submap.T_s_c[submap.n_primary // 2, :3, 3])


def weights(p_s: Float, centre_s: Float) -> Float:
    """(M,) w = 1 / |p - centre|^2 of points (M, 3), world units (paper VI-C.1)."""
    return np.asarray(1 / np.maximum(((p_s - centre_s) ** 2).sum(-1), MIN_DISTANCE2))


def accumulate(fusion: Fusion, rows: AnchorTable, submap: Submap) -> Fusion:
    """The sums after new rows of one sub-map; only their anchors change (paper VI-C.1)."""
    size = max(len(fusion.n), int(rows.anchor.max(initial=-1)) + 1)
    grow = size - len(fusion.n)
    weighted = np.pad(fusion.weighted, ((0, grow), (0, 0)))
    weight, n = np.pad(fusion.weight, (0, grow)), np.pad(fusion.n, (0, grow))
    w = weights(rows.p_s, central_centre(submap))
    np.add.at(weighted, rows.anchor, w[:, None] * se3.transform(submap.T_w_s, rows.p_s))
    np.add.at(weight, rows.anchor, w)
    np.add.at(n, rows.anchor, 1)
    return Fusion(weighted, weight, n)


def suppress(p_w: Float, n: Int, radius: float) -> NDArray[np.bool_]:
    """(A,) active: no neighbour within `radius` was observed by more sub-maps (paper VI-C.2).

    p_w: (A, 3) and radius in world units; the boundary counts as within. One tree a distinct
    count, asked for the nearest better anchor: memory stays O(A) however dense the anchors are.
    """
    from scipy.spatial import cKDTree

    active = np.ones(len(n), bool)
    # the tree's own bound is exclusive, so it gets a little more and the comparison is ours
    bound = radius * (1 + 1e-9) + 1e-12
    for count in np.unique(n)[:-1]:
        tree = cKDTree(p_w[n > count])
        here = np.flatnonzero(n == count)
        distance, _ = tree.query(p_w[here], distance_upper_bound=bound)
        active[here] = distance > radius
    return active


def global_anchors(fusion: Fusion, radius: float) -> GlobalAnchors:
    """Fused positions and their state; radius in world units."""
    p_w = fusion.weighted / fusion.weight[:, None]
    return GlobalAnchors(p_w, fusion.n, suppress(p_w, fusion.n, radius))
