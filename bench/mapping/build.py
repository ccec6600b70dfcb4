"""The sub-maps of a recording with depth and anchors, computed once for every row."""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bench.baselines.overlap import Correspondences, common_views, correspondences
from calm_edge.config import Config, MappingConfig
from calm_edge.geometry import se3
from calm_edge.mapping.cloud import submap_points
from calm_edge.mapping.mapper import Mapper
from calm_edge.mapping.spool import Spool
from calm_edge.mapping.views import prepare
from calm_edge.offline.densify import densified
from calm_edge.offline.submaps import Drive
from calm_edge.recording.reader import Recording
from calm_edge.types import Float32, Prediction, Submap

# of the distortion, map units: about the range in which most of a sub-map's points lie
WAVE = 40.0


@dataclass(frozen=True, slots=True)
class Built:
    """The sub-maps of a drive with their anchors, and what baselines need of the same depth.

    overlaps: between sub-maps k - 1 and k. skipped: why a window has no depth.
    """

    mapper: Mapper
    spool: Spool
    submaps: tuple[Submap, ...]
    overlaps: tuple[Correspondences, ...]
    skipped: tuple[str, ...]


def build(
    path: Path, recording: Recording, config: Config, drive: Drive, folder: Path, warp: float
) -> Built:
    """Depth, anchors and overlaps of every window, once for all rows.

    folder: scratch. warp: amplitude of a depth distortion put into every sub-map, see `warped`.
    """
    spacing = config.scale.spacing
    mapper = Mapper(config.mapping, spacing, folder, config.backbone.seed)
    submaps: list[Submap] = []
    overlaps: list[Correspondences] = []
    skipped: list[str] = []
    last: Prediction | None = None
    depths = densified(path, config, drive.windows, drive.updates)
    for record, update, dense in zip(drive.windows, drive.updates, depths, strict=True):
        if isinstance(dense, str):
            skipped.append(dense)
            continue
        images = [keyframe.frame.bgr() for keyframe in recording.window(record).keyframes()]
        submap, (depth, confidence) = update.submap, dense
        depth = warped(submap, depth, images[0].shape[1::-1], warp, spacing)
        mapper.add(submap, depth, confidence, images)
        new = Prediction(submap.cameras_raw, submap.T_s_c_raw, depth, confidence)
        if last is not None:
            size = np.array(images[0].shape[1::-1])
            views = common_views(submaps[-1], submap)
            overlaps.append(correspondences(last, views[0], new, views[1], size))
        submaps.append(submap)
        last = new
        print(f"depth and anchors: sub-map {submap.id}", file=sys.stderr, flush=True)
    return Built(mapper, Spool(folder), tuple(submaps), tuple(overlaps), tuple(skipped))


def warped(
    submap: Submap, depth: Float32, size: tuple[int, int], amplitude: float, spacing: float
) -> Float32:
    """Depth (N, h, w), raw unit, with the smooth distortion that VI is made for.

    Each point's depth is off by a share of it, at most `amplitude`: a wave over the sub-map's
    space, WAVE spacings long, the same from every view and another one in every sub-map. size:
    (2,) width and height of the images, px. spacing: world units a map unit.
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
    """The k-th sub-map's points (P, 3) as the backbone gave them: its own frame and unit.

    Range and voxel are those of our map, told in that unit.
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
