"""Sub-maps of a recording with depth and anchors, the common input of the mapping tables."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bench.baselines.overlap import Correspondences, common_views, correspondences
from bench.recorded import Recorded, dense
from calm_edge.config import MappingConfig
from calm_edge.geometry import se3
from calm_edge.mapping.cloud import submap_points
from calm_edge.mapping.mapper import Mapper
from calm_edge.mapping.spool import Spool
from calm_edge.mapping.views import prepare
from calm_edge.types import Float32, Prediction, Submap

# wavelength of the smooth error added to depth, map units; about the distance of most points, so
# that the error varies within a sub-map
WAVE = 40.0


@dataclass(frozen=True, slots=True)
class Built:
    """Sub-maps of a drive with depth and anchors, and the points by which baselines align them.

    overlaps: corresponding points of sub-maps k - 1 and k, k = 1, 2 ... skipped: reasons why
    windows have no depth.
    """

    mapper: Mapper
    spool: Spool
    submaps: tuple[Submap, ...]
    overlaps: tuple[Correspondences, ...]
    skipped: tuple[str, ...]


def build(recorded: Recorded, folder: Path, warp: float) -> Built:
    """Compute depth, anchors and overlaps of all windows.

    folder: for temporary files. warp: amplitude of the smooth relative error that `warped` adds to
    the depth, 0 for none.
    """
    config = recorded.config
    spacing = config.scale.spacing
    mapper = Mapper(config.mapping, spacing, folder, config.backbone.seed)
    submaps: list[Submap] = []
    overlaps: list[Correspondences] = []
    skipped: list[str] = []
    last: Prediction | None = None
    for found in dense(recorded):
        if isinstance(found, str):
            skipped.append(found)
            continue
        submap, depth, confidence, images = found
        depth = warped(submap, depth, images[0].shape[1::-1], warp, spacing)
        mapper.add(submap, depth, confidence, images)
        new = Prediction(submap.cameras_raw, submap.T_s_c_raw, depth, confidence)
        if last is not None:
            size = np.array(images[0].shape[1::-1])
            views = common_views(submaps[-1], submap)
            overlaps.append(correspondences(last, views[0], new, views[1], size))
        submaps.append(submap)
        last = new
    return Built(mapper, Spool(folder), tuple(submaps), tuple(overlaps), tuple(skipped))


def warped(
    submap: Submap, depth: Float32, size: tuple[int, int], amplitude: float, spacing: float
) -> Float32:
    """Add a smooth relative error, of the kind that section VI corrects, to depth (N, h, w).

    The error is a wave over the 3-D points of the sub-map with the given amplitude and a wavelength
    of WAVE camera spacings: the same function of the point in all N views, another one in each
    sub-map. depth: in the sub-map's raw unit. size: (2,)
    width and height of the pictures, px. spacing: world units per map unit.
    """
    if not amplitude:
        return depth
    phase = np.random.default_rng([7, submap.id]).uniform(0, 2 * np.pi, 2)
    height, width = depth.shape[1:]
    xy = np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1).astype(np.float64)
    rate = 2 * np.pi / (WAVE * spacing / submap.scale)
    out = np.empty_like(depth)
    for view, (camera, T) in enumerate(zip(submap.cameras_raw, submap.T_s_c_raw, strict=True)):
        small = camera.scaled(width / size[0], height / size[1])
        p_s = se3.transform(T, small.back_project(xy, depth[view].astype(np.float64)))
        wave = np.sin(rate * p_s[..., 2] + phase[0]) * np.cos(rate * p_s[..., 0] + phase[1])
        out[view] = depth[view] * (1 + amplitude * wave)
    return out


def raw_points(built: Built, k: int, config: MappingConfig, spacing: float) -> Float32:
    """Points (P, 3) of the k-th sub-map before any correction, in its own frame and raw unit.

    The points lie within our map's maximum range and are thinned to its voxel size, both converted
    to that unit.
    """
    submap = built.submaps[k]
    spooled = built.spool.depth(submap.id)
    unit = spacing / submap.scale
    views = prepare(
        replace(submap, T_s_c=submap.T_s_c_raw, cameras=submap.cameras_raw, scale=1.0),
        spooled.depth,
        spooled.confidence,
        spooled.image_size,
        config.min_confidence,
        config.max_range * unit,
    )
    color = built.spool.color(submap.id)
    rng = np.random.default_rng([0, submap.id])
    most = config.max_points_per_submap
    return submap_points(views, color, config.cloud_voxel * unit, most, rng)[0]
