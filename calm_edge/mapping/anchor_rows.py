"""Create and concatenate AnchorTables."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from calm_edge.mapping.views import Sightings
from calm_edge.types import AnchorTable, Float, Int


def empty() -> AnchorTable:
    """An AnchorTable without rows."""
    none = np.empty(0, np.int64)
    unseen, no_uv = np.empty(0, np.int32), np.empty((0, 2), np.float32)
    return AnchorTable(none, none, np.empty((0, 3)), unseen, unseen, unseen, no_uv)


def from_sightings(submap_id: int, anchor: Int, p_s: Float, sightings: Sightings) -> AnchorTable:
    """Rows of anchors of one sub-map, with an observation in each view that agrees.

    anchor: (M,) ids. p_s: (M, 3) sub-map frame, world units.
    """
    row, view = np.nonzero(sightings.agrees)
    return AnchorTable(
        anchor,
        np.full(len(anchor), submap_id, np.int64),
        p_s,
        anchor[row].astype(np.int32),
        np.full(len(row), submap_id, np.int32),
        view.astype(np.int32),
        sightings.uv[row, view],
    )


def join(tables: Iterable[AnchorTable]) -> AnchorTable:
    """Concatenate tables in the given order."""
    tables = [empty(), *tables]
    return AnchorTable(
        np.concatenate([t.anchor for t in tables]),
        np.concatenate([t.submap for t in tables]),
        np.concatenate([t.p_s for t in tables]),
        np.concatenate([t.seen_anchor for t in tables]),
        np.concatenate([t.seen_submap for t in tables]),
        np.concatenate([t.seen_view for t in tables]),
        np.concatenate([t.uv for t in tables]),
    )
