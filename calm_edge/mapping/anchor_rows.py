"""Create and concatenate AnchorTables."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from calm_edge.mapping.views import Sightings
from calm_edge.types import AnchorTable, Float, Int


def empty() -> AnchorTable:
    """An AnchorTable without rows."""
    unseen = np.empty(0, np.int32)
    return AnchorTable(
        np.empty(0, np.int64), np.empty((0, 3)), unseen, unseen, np.empty((0, 2), np.float32)
    )


def from_sightings(anchor: Int, p_s: Float, sightings: Sightings) -> AnchorTable:
    """Rows of anchors of one sub-map, with an observation in each view that agrees.

    anchor: (M,) ids. p_s: (M, 3) sub-map frame, world units.
    """
    row, view = np.nonzero(sightings.agrees)
    return AnchorTable(
        anchor,
        p_s,
        anchor[row].astype(np.int32),
        view.astype(np.int32),
        sightings.uv[row, view],
    )


def join(tables: Iterable[AnchorTable]) -> AnchorTable:
    """Concatenate tables in the given order."""
    tables = [empty(), *tables]
    names = AnchorTable.__slots__
    return AnchorTable(*(np.concatenate([getattr(t, name) for t in tables]) for name in names))
