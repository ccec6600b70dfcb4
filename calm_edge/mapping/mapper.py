"""The one owner of mapping state: sub-maps in, tiles out (paper VI)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calm_edge.config import MappingConfig
from calm_edge.geometry import se3
from calm_edge.mapping import anchor_rows, fuse, seams
from calm_edge.mapping.cloud import submap_points
from calm_edge.mapping.deform import Deformation, fit_deformation, unchanged
from calm_edge.mapping.skeleton import Skeleton
from calm_edge.mapping.views import MappingError
from calm_edge.mapping.voxel_filter import VoxelFilter
from calm_edge.types import AnchorTable, Bytes, Float32, MapTile, Submap

PROBES = 2000


class Mapper:
    """Add sub-maps in order, then take the tiles. All that grows with the drive waits on disk.

    In memory stay the sub-maps and deformations, some tens of kilobytes each, the depth of three
    sub-maps and the anchors of eight; `finish` adds 25 bytes an anchor and the voxels around.
    """

    def __init__(
        self, config: MappingConfig, spacing: float, spool_folder: Path, seed: int = 0
    ) -> None:
        """spacing: world units a map unit. spool_folder: scratch, the caller removes it."""
        self._config = config
        self._spacing = spacing
        self._folder = spool_folder
        self._skeleton = Skeleton(config, spacing, spool_folder, seed)
        self._placed: dict[int, Submap] = {}
        self._fusion = fuse.Fusion(spool_folder / "fusion", config.distance_weight)
        self._deformations: dict[int, Deformation] = {}

    def variant(self, config: MappingConfig, folder: Path) -> Mapper:
        """A Mapper of the sub-maps added so far, and of their anchors, that fuses and deforms by
        another config; what extraction takes from a config stays as it was. folder: its scratch.
        """
        other = Mapper.__new__(Mapper)
        folder.mkdir(parents=True, exist_ok=True)
        other._config, other._spacing, other._folder = config, self._spacing, folder
        other._skeleton, other._placed = self._skeleton, dict(self._placed)
        other._fusion = fuse.Fusion(folder / "fusion", config.distance_weight)
        other._deformations = {}
        other._fuse_again()
        return other

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
        fresh = self._skeleton.add(submap, depth, confidence, images)
        self._placed[submap.id] = submap
        for submap_id, rows in fresh.items():
            self._fusion.add(rows, self._placed[submap_id])

    def finish(self, submaps: Iterable[Submap] = ()) -> Iterator[MapTile]:
        """Tiles in sub-map order, no two points of the map in one voxel.

        submaps: placements newer than those added; only T_w_s may differ. Raises MappingError for
        a sub-map that is unknown or whose scale or rectified geometry changed.
        """
        self._move(submaps)
        active = self._active()
        thin = VoxelFilter(self._config.cloud_voxel * self._spacing, self._folder)
        for submap_id in sorted(self._placed):
            points, color = self.points(submap_id)
            deformation = self._fit(submap_id, active, points)
            self._deformations[submap_id] = deformation
            points_w = se3.transform(self._placed[submap_id].T_w_s, deformation.apply(points))
            keep = thin.admit(points_w)
            yield MapTile(points_w[keep].astype(np.float32), color[keep], submap_id)

    def points(self, submap_id: int) -> tuple[Float32, Bytes]:
        """A sub-map's points (P, 3), its frame, world units, before the deformation; RGB (P, 3)."""
        return submap_points(
            self._skeleton.views(submap_id),
            self._skeleton.color(submap_id),
            self._config.cloud_voxel * self._spacing,
            self._config.max_points_per_submap,
            self._skeleton.rng(submap_id),
        )

    def table(self) -> AnchorTable:
        """The rows of all sub-maps."""
        return anchor_rows.join(self._skeleton.tables[i] for i in sorted(self._placed))

    def seams(self) -> tuple[seams.Seam, ...]:
        """Seams of the sub-maps that share a picture, once `finish` has handed out both tiles."""
        done = self._deformations
        pairs = [(a, b) for a, b in self._skeleton.linked() if a in done and b in done]
        T_w_s = {i: s.T_w_s for i, s in self._placed.items()}
        return seams.seams(pairs, self._skeleton.tables, T_w_s, done)

    def deformations(self) -> dict[int, Deformation]:
        """Sub-map id -> the deformation of its tile, of the tiles `finish` has handed out."""
        return dict(self._deformations)

    def _active(self) -> NDArray[np.bool_]:
        if not self._config.suppress:
            return np.ones(len(self._fusion), bool)
        return self._fusion.active(self._config.suppression_radius * self._spacing)

    def _fit(self, submap_id: int, active: NDArray[np.bool_], points: Float32) -> Deformation:
        if not self._config.deform:
            return unchanged()
        rows, submap = self._skeleton.tables[submap_id], self._placed[submap_id]
        here = active[rows.anchor]
        p_w, n = self._fusion.at(rows.anchor[here])
        return fit_deformation(
            rows.p_s[here],
            se3.transform(se3.inverse(submap.T_w_s), p_w),
            n,
            fuse.central_centre(submap),
            points[:: max(1, len(points) // PROBES)],
            self._config.stiffness,
            self._config.max_control_points,
        )

    def _move(self, submaps: Iterable[Submap]) -> None:
        moved = False
        for submap in submaps:
            known = self._placed.get(submap.id)
            if known is None:
                raise MappingError(f"sub-map {submap.id}: placed but never added; map it again")
            same = submap.scale == known.scale and np.array_equal(submap.K, known.K)
            if not (same and np.array_equal(submap.T_s_c, known.T_s_c)):
                raise MappingError(
                    f"sub-map {submap.id}: rectified since it was added; map it again"
                )
            moved |= not np.array_equal(submap.T_w_s, known.T_w_s)
            self._placed[submap.id] = submap
        if moved:
            self._fuse_again()

    def _fuse_again(self) -> None:
        self._fusion.clear()
        for submap_id, rows in self._skeleton.tables.items():
            self._fusion.add(rows, self._placed[submap_id])
