"""Globally consistent mapping (paper VI): takes sub-maps, yields deformed map tiles."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calm_edge.config import MappingConfig
from calm_edge.geometry import se3
from calm_edge.mapping import fuse, seams
from calm_edge.mapping.cloud import submap_points
from calm_edge.mapping.deform import Deformation, fit_deformation, unchanged
from calm_edge.mapping.skeleton import Skeleton
from calm_edge.mapping.views import MappingError
from calm_edge.mapping.voxel_filter import VoxelFilter
from calm_edge.types import Bytes, Float32, MapTile, Submap

# points of a sub-map at which its deformation is checked for folding
PROBES = 2000


class Mapper:
    """Builds the map of a drive: `add` each sub-map in order, then iterate over `finish`.

    Depth, anchors and voxels of the drive are kept on disk. In memory: sub-maps and deformations
    (some ten kilobytes each), depth of three sub-maps, anchors of eight; during `finish` also 25
    bytes per anchor and the voxels nearby.
    """

    def __init__(
        self, config: MappingConfig, spacing: float, spool_folder: Path, seed: int = 0
    ) -> None:
        """spacing: world units per map unit. spool_folder: scratch files, removed by the caller."""
        self._config = config
        self._spacing = spacing
        self._folder = spool_folder
        self._skeleton = Skeleton(config, spacing, spool_folder, seed)
        self._placed: dict[int, Submap] = {}
        self._fusion = fuse.Fusion(spool_folder / "fusion", config.distance_weight)
        self._deformations: dict[int, Deformation] = {}

    def variant(self, config: MappingConfig, folder: Path) -> Mapper:
        """Create a second Mapper with the same sub-maps and anchors, to compare configurations.

        config: of fusion and deformation; extraction is not repeated. folder: its scratch folder.
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
        images: Sequence[NDArray[np.uint8] | None],
    ) -> None:
        """Add a sub-map with depth (N, h, w), raw unit, confidence (N, h, w) and N BGR images.

        An image may be None if its view has no depth. Raises MappingError if their
        sizes do not match or the id has been added before.
        """
        fresh = self._skeleton.add(submap, depth, confidence, images)
        self._placed[submap.id] = submap
        for submap_id, rows in fresh.items():
            self._fusion.add(rows, self._placed[submap_id])

    def submap_ids(self) -> list[int]:
        """Ids of the sub-maps added, in the order of the tiles."""
        return sorted(self._placed)

    def finish(self, submaps: Iterable[Submap] = ()) -> Iterator[MapTile]:
        """Yield one tile per sub-map, in order of ids; over all tiles one point per voxel.

        submaps: sub-maps with newer poses; only T_w_s may differ from those added. Raises
        MappingError for an unknown sub-map or one with another scale or rectified geometry.
        """
        self._move(submaps)
        active = self._active()
        thin = VoxelFilter(self._config.cloud_voxel * self._spacing, self._folder)
        for submap_id in self.submap_ids():
            points, color = self.points(submap_id)
            deformation = self._fit(submap_id, active, points)
            self._deformations[submap_id] = deformation
            points_w = se3.transform(self._placed[submap_id].T_w_s, deformation.apply(points))
            keep = thin.admit(points_w)
            yield MapTile(points_w[keep].astype(np.float32), color[keep])

    def points(self, submap_id: int) -> tuple[Float32, Bytes]:
        """Points (P, 3), sub-map frame, world units, before deformation, and RGB colours (P, 3)."""
        return submap_points(
            self._skeleton.views(submap_id),
            self._skeleton.color(submap_id),
            self._config.cloud_voxel * self._spacing,
            self._config.max_points_per_submap,
            self._skeleton.rng(submap_id),
        )

    def seams(self) -> tuple[seams.Seam, ...]:
        """Seams between sub-maps with common images, for those whose tiles have been yielded."""
        done = self._deformations
        pairs = [(a, b) for a, b in self._skeleton.linked() if a in done and b in done]
        T_w_s = {i: s.T_w_s for i, s in self._placed.items()}
        return seams.seams(pairs, self._skeleton.tables, T_w_s, done)

    def deformations(self) -> dict[int, Deformation]:
        """Deformation by sub-map id, for the tiles yielded so far."""
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
                raise MappingError(
                    f"sub-map {submap.id}: has a pose but no depth; run calm-edge map again"
                )
            same = submap.scale == known.scale and submap.cameras == known.cameras
            if not (same and np.array_equal(submap.T_s_c, known.T_s_c)):
                raise MappingError(
                    f"sub-map {submap.id}: scale or geometry changed after it was added; "
                    "run calm-edge map again"
                )
            moved |= not np.array_equal(submap.T_w_s, known.T_w_s)
            self._placed[submap.id] = submap
        if moved:
            self._fuse_again()

    def _fuse_again(self) -> None:
        self._fusion.clear()
        for submap_id, rows in self._skeleton.tables.items():
            self._fusion.add(rows, self._placed[submap_id])
