"""Anchors of a drive: extraction per sub-map and propagation between them (VI-A, VI-B)."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calm_edge.config import MappingConfig
from calm_edge.mapping.extract import extract
from calm_edge.mapping.propagate import copy_forward, picture_keys, same_pictures, spread_back
from calm_edge.mapping.spool import Spool
from calm_edge.mapping.table_store import TableStore
from calm_edge.mapping.views import DenseViews, MappingError, prepare
from calm_edge.types import AnchorTable, Bytes, Float32, Int, Submap

# number of sub-maps with depth in memory: backward propagation rarely reaches further
CACHED = 3


class Skeleton:
    """Sub-maps with their dense views and anchor tables, linked by common images.

    In memory: the sub-maps, depth of three and anchors of eight. The rest is in `folder`, which
    the caller removes.
    """

    def __init__(self, config: MappingConfig, spacing: float, folder: Path, seed: int) -> None:
        """spacing: world units per map unit."""
        self._config = config
        self._max_range = config.max_range * spacing
        self._seed = seed
        self._spool = Spool(folder)
        self._tables = TableStore(folder)
        self._submaps: dict[int, Submap] = {}
        self._shared: dict[int, list[tuple[int, Int]]] = {}
        self._holders: dict[int, list[int]] = {}
        self._views: OrderedDict[int, DenseViews] = OrderedDict()
        self._n_anchors = 0

    @property
    def tables(self) -> Mapping[int, AnchorTable]:
        """Anchor table by sub-map id, propagated anchors included."""
        return self._tables

    def add(
        self,
        submap: Submap,
        depth: Float32,
        confidence: Float32,
        images: Sequence[NDArray[np.uint8] | None],
    ) -> dict[int, AnchorTable]:
        """Add a sub-map; returns the new anchor rows by sub-map id, propagated ones included.

        Arguments and MappingError as in `Mapper.add`; on an error the state is unchanged.
        """
        if submap.id in self._submaps:
            raise MappingError(f"sub-map {submap.id}: added twice; give each sub-map its own id")
        self._spool.write(submap.id, depth, confidence, images)
        self._submaps[submap.id] = submap
        try:
            views = self.views(submap.id)
        except MappingError:
            del self._submaps[submap.id]
            raise
        self._link(submap)
        tolerance = self._config.depth_tolerance
        sources = [
            (self._tables[other], pairs[:, ::-1]) for other, pairs in self._shared[submap.id]
        ]
        seeds = copy_forward(sources, views, tolerance)
        grid, rng = self._config.grid, self.rng(submap.id)
        table = extract(views, seeds, self._n_anchors, grid, tolerance, rng)
        self._n_anchors = max(self._n_anchors, int(table.anchor.max(initial=-1)) + 1)
        self._tables[submap.id] = table
        back = spread_back(submap.id, self._tables, self._shared.__getitem__, self.views, tolerance)
        for other, rows in back.items():
            self._tables[other] = AnchorTable.joined([self._tables[other], rows])
        return {submap.id: table, **back}

    def views(self, submap_id: int) -> DenseViews:
        """Dense views of a sub-map. Raises MappingError."""
        if submap_id not in self._views:
            spooled = self._spool.depth(submap_id)
            self._views[submap_id] = prepare(
                self._submaps[submap_id],
                spooled.depth,
                spooled.confidence,
                spooled.image_size,
                self._config.min_confidence,
                self._max_range,
            )
        self._views.move_to_end(submap_id)
        while len(self._views) > CACHED:
            self._views.popitem(last=False)
        return self._views[submap_id]

    def color(self, submap_id: int) -> Bytes:
        """Colours (N, h, w, 3), RGB, of the dense views. Raises MappingError."""
        return self._spool.color(submap_id)

    def linked(self) -> list[tuple[int, int]]:
        """Pairs (earlier id, later id) of sub-maps with common images, sorted by the later id."""
        return [(a, b) for b in sorted(self._shared) for a, _ in self._shared[b] if a < b]

    def rng(self, submap_id: int) -> np.random.Generator:
        """Random generator of a sub-map, independent of draws for other sub-maps."""
        return np.random.default_rng([self._seed, submap_id])

    def _link(self, submap: Submap) -> None:
        """Record the common images of the new sub-map with each earlier one, in both directions."""
        keys = picture_keys(submap).tolist()
        others = sorted({other for key in keys for other in self._holders.get(key, [])})
        self._shared[submap.id] = []
        for other in others:
            pairs = same_pictures(submap, self._submaps[other])
            self._shared[submap.id].append((other, pairs))
            self._shared[other].append((submap.id, pairs[:, ::-1]))
        for key in keys:
            self._holders.setdefault(key, []).append(submap.id)
