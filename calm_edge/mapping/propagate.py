"""Anchors carried between sub-maps through the pictures they share (paper VI-B)."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from calm_edge.mapping import anchor_rows
from calm_edge.mapping.views import DenseViews, confirmed, lift, sample, sight
from calm_edge.types import AnchorTable, Int, Submap
from device.frame import Eye


def picture_keys(submap: Submap) -> Int:
    """(N,) a number each picture has in every sub-map that holds it: its time and eye.

    Views beyond the primary and assistant ones are loop keyframes, which are primary.
    """
    eye = np.full(len(submap.t_ns), int(Eye.PRIMARY))
    first = submap.n_primary
    eye[first : first + len(submap.assistant_ids)] = int(Eye.ASSISTANT)
    return np.asarray(submap.t_ns * 2 + eye)


def same_pictures(a: Submap, b: Submap) -> Int:
    """(P, 2) pairs (view of a, view of b) that are one picture: overlap and loop frames alike."""
    _, view_a, view_b = np.intersect1d(picture_keys(a), picture_keys(b), return_indices=True)
    return np.stack([view_a, view_b], -1).astype(np.int64)


def carried(source: AnchorTable, pairs: Int, present: Int) -> AnchorTable:
    """The sightings of `source` in shared pictures, renumbered to the other sub-map's views.

    source: one sub-map's rows. pairs: (P, 2) (its view, the other's view). present: (X,) anchors
    the other sub-map already has.
    """
    other_view = np.full(int(max(source.seen_view.max(initial=-1), pairs.max(initial=-1))) + 1, -1)
    other_view[pairs[:, 0]] = pairs[:, 1]
    view = other_view[source.seen_view]
    take = (view >= 0) & ~np.isin(source.seen_anchor, present)
    none = anchor_rows.empty()
    return AnchorTable(
        none.anchor,
        none.submap,
        none.p_s,
        source.seen_anchor[take],
        source.seen_submap[take],
        view[take].astype(np.int32),
        source.uv[take],
    )


def place(
    carried_rows: AnchorTable, target: DenseViews, target_id: int, tolerance: float
) -> AnchorTable:
    """Carried sightings back-projected with the target sub-map's own depth and verified there.

    The paper copies seeds forward without a check; here both directions pass the same
    verification, which drops what the target sees as an occlusion edge. Of several shared
    pictures the one most views agree with gives the position.
    """
    anchor, view = (a.astype(np.int64) for a in (carried_rows.seen_anchor, carried_rows.seen_view))
    uv = carried_rows.uv
    z = sample(target, view, uv)
    known = z > 0
    anchor, view, uv, z = anchor[known], view[known], uv[known], z[known]
    p_s = lift(target, view, uv, z)
    sightings = sight(target, p_s, tolerance)
    # projecting back is exact only up to rounding: the copied pixel itself is the truth
    sightings.uv[np.arange(len(view)), view] = uv
    sightings.agrees[np.arange(len(view)), view] = True
    support = np.where(confirmed(sightings, view), sightings.agrees.sum(1), 0)
    order = np.lexsort((-support, anchor))
    order = order[np.unique(anchor[order], return_index=True)[1]]
    best = order[support[order] > 0]
    return anchor_rows.from_sightings(target_id, anchor[best], p_s[best], sightings.of(best))


def copy_forward(
    sources: Sequence[tuple[AnchorTable, Int]],
    target: DenseViews,
    target_id: int,
    tolerance: float,
) -> AnchorTable:
    """Seeds of a new sub-map from (table, pairs) of every earlier one that shares a picture."""
    seeds = anchor_rows.empty()
    for table, pairs in sources:
        rows = carried(table, pairs, seeds.anchor)
        seeds = anchor_rows.join([seeds, place(rows, target, target_id, tolerance)])
    return seeds


def spread_back(
    start: int,
    tables: Mapping[int, AnchorTable],
    shared: Callable[[int], Sequence[tuple[int, Int]]],
    views_of: Callable[[int], DenseViews],
    tolerance: float,
) -> dict[int, AnchorTable]:
    """Rows to add to other sub-maps after sub-map `start` is complete (paper VI-B, recursion).

    shared: sub-map -> [(other, pairs (view, other's view))]. views_of loads depth and is called
    only when an anchor is seen in a shared picture. What arrives in a sub-map goes on from there
    to all that share a picture with it; each anchor enters a sub-map once, so this ends.
    """
    added: dict[int, AnchorTable] = {}
    queue = deque([(start, tables[start])])
    while queue:
        at, rows = queue.popleft()
        for other, pairs in shared(at):
            there = anchor_rows.join([tables[other], added.get(other, anchor_rows.empty())])
            moving = carried(rows, pairs, there.anchor)
            if not len(moving.seen_anchor):
                continue
            placed = place(moving, views_of(other), other, tolerance)
            if len(placed.anchor):
                added[other] = anchor_rows.join([added.get(other, anchor_rows.empty()), placed])
                queue.append((other, placed))
    return added
