"""Anchor extraction of one sub-map: a random confident pixel per grid cell, verified (VI-A)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calm_edge.mapping.views import DenseViews, confirmed, lift, sight
from calm_edge.types import AnchorTable, Int, Int32

Bool = NDArray[np.bool_]


def cell_of(views: DenseViews, view: Int | Int32, uv: NDArray[np.floating], grid: int) -> Int:
    """Grid cell index (...) in [0, grid^2) of image pixels uv (..., 2) in views (...)."""
    height, width = views.inverse_depth.shape[1:]
    share = (views.to_map(view, uv) + 0.5) / [width, height]
    column, row = np.moveaxis(np.clip((share * grid).astype(np.int64), 0, grid - 1), -1, 0)
    return np.asarray(row * grid + column)


def draw_candidates(
    usable: Bool, wanted: Bool, grid: int, rng: np.random.Generator
) -> NDArray[np.int64]:
    """Draw one random usable pixel of each wanted cell that has any: flat pixel indices (M,).

    usable: (h, w). wanted: (grid^2,).
    """
    height, width = usable.shape
    row = (2 * np.arange(height) + 1) * grid // (2 * height)
    column = (2 * np.arange(width) + 1) * grid // (2 * width)
    pixel = np.flatnonzero(usable)
    cell = (row[:, None] * grid + column).reshape(-1)[pixel]
    pixel = pixel[np.argsort(cell, kind="stable")]
    count = np.bincount(cell, minlength=grid * grid)
    first = np.cumsum(count) - count
    pick = first + (rng.random(grid * grid) * count).astype(np.int64)
    return np.asarray(pixel[pick[wanted & (count > 0)]])


def extract(
    views: DenseViews,
    seeds: AnchorTable,
    first_id: int,
    grid: int,
    tolerance: float,
    rng: np.random.Generator,
) -> AnchorTable:
    """Extract anchors of a sub-map by grid sampling and densification (paper VI-A.1, VI-A.2).

    seeds: anchors propagated from earlier sub-maps; part of the result. first_id: id of the first
    new anchor. Frame by frame (both cameras, batch order) each cell without an anchor gets a
    candidate. An anchor occupies its cell only in frames with the same depth there: an anchor that
    is occluded in a frame does not.
    """
    n_views, _, width = views.inverse_depth.shape
    filled = np.zeros((n_views, grid * grid), bool)
    filled[seeds.seen_view, cell_of(views, seeds.seen_view, seeds.uv, grid)] = True
    tables = [seeds]
    for t in range(n_views):
        pixel = draw_candidates(views.usable[t], ~filled[t], grid, rng)
        if not len(pixel):
            continue
        own = np.full(len(pixel), t)
        uv = views.to_image(own, np.stack([pixel % width, pixel // width], -1))
        p_s = lift(views, own, uv, 1 / views.inverse_depth[t].reshape(-1)[pixel].astype(float))
        sightings = sight(views, p_s, tolerance)
        keep = confirmed(sightings, own)
        ids = np.arange(first_id, first_id + int(keep.sum()))
        first_id += len(ids)
        table = sightings.of(keep).rows(ids, p_s[keep])
        filled[table.seen_view, cell_of(views, table.seen_view, table.uv, grid)] = True
        tables.append(table)
    return AnchorTable.joined(tables)
