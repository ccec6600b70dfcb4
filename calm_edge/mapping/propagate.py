"""Anchor propagation between sub-maps through their common images (paper VI-B)."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from calm_edge.mapping.views import DenseViews, confirmed, lift, sample, sight
from calm_edge.types import AnchorTable, Int, Submap
from device.frame import Eye


def picture_keys(submap: Submap) -> Int:
    """Keys (N,) of the images of a sub-map, from stamp and camera: equal for equal images.

    Views after the primary and assistant ones are loop keyframes, which are primary images.
    """
    eye = np.full(len(submap.t_ns), int(Eye.PRIMARY))
    first = submap.n_primary
    eye[first : first + len(submap.assistant_ids)] = int(Eye.ASSISTANT)
    return np.asarray(submap.t_ns * 2 + eye)


def same_pictures(a: Submap, b: Submap) -> Int:
    """Pairs (P, 2) of (view of a, view of b) with the same image: overlap and loop frames."""
    _, view_a, view_b = np.intersect1d(picture_keys(a), picture_keys(b), return_indices=True)
    return np.stack([view_a, view_b], -1).astype(np.int64)


def carried(source: AnchorTable, pairs: Int, present: Int) -> AnchorTable:
    """Observations of anchors in common images, renumbered to the views of the other sub-map.

    source: rows of one sub-map. pairs: (P, 2) of (its view, the other's view). present: (X,)
    anchors that the other sub-map has already; these are left out.
    """
    other_view = np.full(int(max(source.seen_view.max(initial=-1), pairs.max(initial=-1))) + 1, -1)
    other_view[pairs[:, 0]] = pairs[:, 1]
    view = other_view[source.seen_view]
    take = (view >= 0) & ~np.isin(source.seen_anchor, present)
    none = AnchorTable.empty()
    return AnchorTable(
        none.anchor,
        none.p_s,
        source.seen_anchor[take],
        view[take].astype(np.int32),
        source.uv[take],
    )


def place(carried_rows: AnchorTable, target: DenseViews, tolerance: float) -> AnchorTable:
    """Back-project observations with the depth of the target sub-map and verify them there.

    Returns the verified anchors, as rows of the target's table. The paper verifies only backward
    propagation; here forward copies are verified too, which rejects pixels on the target's
    occlusion edges. If an anchor has observations in several common images, the position on which
    most views agree is taken.
    """
    anchor, view = (a.astype(np.int64) for a in (carried_rows.seen_anchor, carried_rows.seen_view))
    uv = carried_rows.uv
    z = sample(target, view, uv)
    known = z > 0
    anchor, view, uv, z = anchor[known], view[known], uv[known], z[known]
    p_s = lift(target, view, uv, z)
    sightings = sight(target, p_s, tolerance)
    # keep the copied pixel, from which the reprojected one differs by rounding
    sightings.uv[np.arange(len(view)), view] = uv
    sightings.agrees[np.arange(len(view)), view] = True
    support = np.where(confirmed(sightings, view), sightings.agrees.sum(1), 0)
    order = np.lexsort((-support, anchor))
    order = order[np.unique(anchor[order], return_index=True)[1]]
    best = order[support[order] > 0]
    return sightings.of(best).rows(anchor[best], p_s[best])


def copy_forward(
    sources: Sequence[tuple[AnchorTable, Int]], target: DenseViews, tolerance: float
) -> AnchorTable:
    """Forward propagation: anchors that a new sub-map takes over from earlier ones (its seeds).

    sources: (anchor table, pairs (P, 2) of (its view, target's view)) of each earlier sub-map.
    """
    seeds = AnchorTable.empty()
    for table, pairs in sources:
        rows = carried(table, pairs, seeds.anchor)
        seeds = AnchorTable.joined([seeds, place(rows, target, tolerance)])
    return seeds


def spread_back(
    start: int,
    tables: Mapping[int, AnchorTable],
    shared: Callable[[int], Sequence[tuple[int, Int]]],
    views_of: Callable[[int], DenseViews],
    tolerance: float,
) -> dict[int, AnchorTable]:
    """Backward propagation from sub-map `start`, recursively: rows to add, by sub-map id (VI-B).

    shared: sub-map id -> [(other id, pairs (P, 2) of (view, other's view))]. views_of: loads the
    dense views of a sub-map; called only if there is an anchor to add. tolerance: largest relative
    depth difference at which a view confirms an anchor. Rows added to a sub-map are propagated
    further from it; an anchor enters each sub-map once, so that the recursion ends.
    """
    added: dict[int, AnchorTable] = {}
    queue = deque([(start, tables[start])])
    while queue:
        at, rows = queue.popleft()
        for other, pairs in shared(at):
            there = AnchorTable.joined([tables[other], added.get(other, AnchorTable.empty())])
            moving = carried(rows, pairs, there.anchor)
            if not len(moving.seen_anchor):
                continue
            placed = place(moving, views_of(other), tolerance)
            if len(placed.anchor):
                added[other] = AnchorTable.joined([added.get(other, AnchorTable.empty()), placed])
                queue.append((other, placed))
    return added
