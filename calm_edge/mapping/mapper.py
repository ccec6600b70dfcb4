"""The one owner of mapping state: sub-maps in, tiles out (paper VI)."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calm_edge.config import MappingConfig
from calm_edge.geometry import se3
from calm_edge.mapping import anchor_rows, fuse, seams
from calm_edge.mapping.cloud import VoxelFilter, submap_points
from calm_edge.mapping.deform import Deformation, fit_deformation
from calm_edge.mapping.extract import extract
from calm_edge.mapping.propagate import copy_forward, picture_keys, same_pictures, spread_back
from calm_edge.mapping.spool import Spool
from calm_edge.mapping.views import DenseViews, MappingError, prepare
from calm_edge.types import AnchorTable, Float32, GlobalAnchors, Int, MapTile, Submap

# sub-maps whose depth stays in memory: the new one and those its anchors usually travel back to
CACHED = 3
PROBES = 2000


class Mapper:
    """Add sub-maps in order, then take the tiles. Depth and colour wait on disk in between.

    In memory stay the anchors (up to 6 MB a sub-map of 30 views) and the depth of three sub-maps.
    """

    def __init__(
        self, config: MappingConfig, spacing: float, spool_folder: Path, seed: int = 0
    ) -> None:
        """spacing: world units a map unit. spool_folder: scratch, the caller removes it."""
        self._config = config
        self._spacing = spacing
        self._spool = Spool(spool_folder)
        self._seed = seed
        self._submaps: dict[int, Submap] = {}
        self._tables: dict[int, AnchorTable] = {}
        self._shared: dict[int, list[tuple[int, Int]]] = {}
        self._holders: dict[int, list[int]] = {}
        self._views: OrderedDict[int, DenseViews] = OrderedDict()
        self._fusion = fuse.nothing()
        self._deformations: dict[int, Deformation] = {}

    def add(
        self,
        submap: Submap,
        depth: Float32,
        confidence: Float32,
        images: Sequence[NDArray[np.uint8]],
    ) -> None:
        """A sub-map with its depth (N, h, w), raw unit, confidence (N, h, w) and N BGR images.

        Raises MappingError when they do not fit each other, or the id was added before.
        """
        if submap.id in self._submaps:
            raise MappingError(f"sub-map {submap.id}: added twice; give each sub-map its own id")
        self._spool.write(submap.id, depth, confidence, images)
        self._submaps[submap.id] = submap
        try:
            views = self._load(submap.id)
        except MappingError:
            del self._submaps[submap.id]
            raise
        self._link(submap)
        config = self._config
        sources = [
            (self._tables[other], pairs[:, ::-1]) for other, pairs in self._shared[submap.id]
        ]
        seeds = copy_forward(sources, views, submap.id, config.depth_tolerance)
        table = extract(
            views,
            submap.id,
            seeds,
            len(self._fusion.n),
            config.grid,
            config.depth_tolerance,
            self._rng(submap.id),
        )
        self._tables[submap.id] = table
        back = spread_back(
            submap.id, self._tables, self._shared.__getitem__, self._load, config.depth_tolerance
        )
        for other, rows in ((submap.id, table), *back.items()):
            self._fusion = fuse.accumulate(self._fusion, rows, self._submaps[other])
        for other, rows in back.items():
            self._tables[other] = anchor_rows.join([self._tables[other], rows])

    def finish(self, submaps: Iterable[Submap] = ()) -> Iterator[MapTile]:
        """Tiles in sub-map order, no two points of the map in one voxel.

        submaps: placements newer than those added; only T_w_s may differ. Raises MappingError for
        a sub-map that is unknown or whose scale or rectified geometry changed.
        """
        self._move(submaps)
        anchors = self.anchors()
        thin = VoxelFilter(self._config.cloud_voxel * self._spacing)
        for submap_id in sorted(self._submaps):
            yield self._tile(submap_id, anchors, thin)

    def anchors(self) -> GlobalAnchors:
        """Fused anchors of everything added so far, indexed by anchor id."""
        return fuse.global_anchors(self._fusion, self._config.suppression_radius * self._spacing)

    def table(self) -> AnchorTable:
        """The rows of all sub-maps."""
        return anchor_rows.join(self._tables[i] for i in sorted(self._tables))

    def seams(self) -> tuple[seams.Seam, ...]:
        """Seams of the sub-maps that share a picture, once `finish` has handed out both tiles."""
        done = self._deformations
        pairs = [(a, b) for b in sorted(done) for a, _ in self._shared[b] if a < b and a in done]
        T_w_s = {i: s.T_w_s for i, s in self._submaps.items()}
        return seams.seams(pairs, self._tables, T_w_s, done)

    def deformations(self) -> dict[int, Deformation]:
        """Sub-map id -> the deformation of its tile, of the tiles `finish` has handed out."""
        return dict(self._deformations)

    def _tile(self, submap_id: int, anchors: GlobalAnchors, thin: VoxelFilter) -> MapTile:
        config, submap, rows = self._config, self._submaps[submap_id], self._tables[submap_id]
        points, color = submap_points(
            self._load(submap_id),
            self._spool.color(submap_id),
            config.cloud_voxel * self._spacing,
            config.max_points_per_submap,
            self._rng(submap_id),
        )
        active = anchors.active[rows.anchor]
        ids = rows.anchor[active]
        deformation = fit_deformation(
            rows.p_s[active],
            se3.transform(se3.inverse(submap.T_w_s), anchors.p_w[ids]),
            anchors.n_observations[ids],
            fuse.central_centre(submap),
            points[:: max(1, len(points) // PROBES)],
            config.stiffness,
            config.max_control_points,
        )
        self._deformations[submap_id] = deformation
        points_w = se3.transform(submap.T_w_s, deformation.apply(points))
        keep = thin.admit(points_w)
        return MapTile(points_w[keep].astype(np.float32), color[keep], submap_id)

    def _link(self, submap: Submap) -> None:
        """Find the pictures the new sub-map shares with earlier ones, both ways."""
        keys = picture_keys(submap).tolist()
        others = sorted({other for key in keys for other in self._holders.get(key, [])})
        self._shared[submap.id] = []
        for other in others:
            pairs = same_pictures(submap, self._submaps[other])
            self._shared[submap.id].append((other, pairs))
            self._shared[other].append((submap.id, pairs[:, ::-1]))
        for key in keys:
            self._holders.setdefault(key, []).append(submap.id)

    def _load(self, submap_id: int) -> DenseViews:
        if submap_id not in self._views:
            spooled = self._spool.depth(submap_id)
            self._views[submap_id] = prepare(
                self._submaps[submap_id],
                spooled.depth,
                spooled.confidence,
                spooled.image_size,
                self._config.min_confidence,
                self._config.max_range * self._spacing,
            )
        self._views.move_to_end(submap_id)
        while len(self._views) > CACHED:
            self._views.popitem(last=False)
        return self._views[submap_id]

    def _move(self, submaps: Iterable[Submap]) -> None:
        for submap in submaps:
            known = self._submaps.get(submap.id)
            if known is None:
                raise MappingError(f"sub-map {submap.id}: placed but never added; map it again")
            same = submap.scale == known.scale and np.array_equal(submap.K, known.K)
            if not (same and np.array_equal(submap.T_s_c, known.T_s_c)):
                raise MappingError(
                    f"sub-map {submap.id}: rectified since it was added; map it again"
                )
            self._submaps[submap.id] = submap
        self._fusion = fuse.nothing()
        for submap_id, rows in self._tables.items():
            self._fusion = fuse.accumulate(self._fusion, rows, self._submaps[submap_id])

    def _rng(self, submap_id: int) -> np.random.Generator:
        return np.random.default_rng([self._seed, submap_id])
