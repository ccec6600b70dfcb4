"""Write the outputs of `map`: point cloud, trajectory and summary."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import asdict, replace
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np

from calm_edge.config import Config, merge
from calm_edge.evaluation.estimate import Estimate, of_recording
from calm_edge.mapping.cloud_file import CloudWriter
from calm_edge.mapping.mapper import Mapper
from calm_edge.mapping.seams import Seam, SeamSummary
from calm_edge.mapping.spool import Spool
from calm_edge.offline.densify import densified, pictures
from calm_edge.offline.drive import Drive
from calm_edge.offline.map_times import MapTimes
from calm_edge.offline.progress import Progress
from calm_edge.recording import RecordingError
from calm_edge.recording.reader import Recording
from calm_edge.recording.time_base import ORIGIN_KEY
from calm_edge.recording.writer import RecordingWriter
from calm_edge.trajectories import write_kitti, write_tum
from calm_edge.types import Float32, Int

MAP, TUM, KITTI, SUMMARY, REPORT, PAGE = (
    "map.ply",
    "trajectory.tum",
    "trajectory.kitti",
    "summary.json",
    "report.html",
    "map.html",
)
# folder with the sub-maps as `map` has solved and placed them, in the form of a recording
SUBMAPS = "submaps"
OUTPUTS = (MAP, TUM, KITTI, SUMMARY, REPORT, PAGE)


def make_cloud(
    recording: Recording,
    config: Config,
    drive: Drive,
    out: Path,
    spool: Path,
    say: Callable[[str], None],
    times: MapTimes,
) -> tuple[Int, tuple[Seam, ...]]:
    """Compute depth and anchors of all sub-maps and write map.ply, over an existing one.

    spool: folder for scratch files, removed by the caller; depth found in it is not computed again.
    times: takes those of the stages. Returns the number of points of each sub-map that has depth,
    in the order of their ids as in the file, as rows (id, points), and the seams.
    """
    mapper = Mapper(config.mapping, config.scale.spacing, spool, config.backbone.seed)
    earlier = Spool(spool)
    known = [earlier.holds(update.submap.id) for update in drive.updates]
    windows = list(compress(drive.windows, np.logical_not(known)))
    # what the drive knew at its end of the bonnet holds for all windows
    masks = drive.updates[-1].masks if drive.updates else None
    unknown = compress(drive.updates, np.logical_not(known))
    updates = [replace(update, masks=masks) for update in unknown]
    depths = densified(recording.path, config, windows, updates)
    progress = Progress("depth and anchors of sub-maps", len(known), say)
    for record, update, done in zip(drive.windows, drive.updates, known, strict=True):
        # computed by workers meanwhile: what is waited for
        with times.stage("depth"):
            depth = _spooled(earlier, update.submap.id) if done else next(depths)
        if isinstance(depth, str):
            drive.losses.append(depth)
            continue
        with times.stage("anchors"):
            mapper.add(update.submap, *depth, pictures(recording.window(record), depth[0]))
        progress.step(free=done)
    say("fusing and deforming the sub-maps")
    sizes = []
    with times.stage("fusion and deformation"), CloudWriter(out / MAP, replace=True) as cloud:
        for tile in mapper.finish():
            cloud.write(tile)
            sizes.append(len(tile.points_w))
    rows = np.array([mapper.submap_ids(), sizes], np.int64).T
    return rows, mapper.seams()


def _spooled(spool: Spool, submap_id: int) -> tuple[Float32, Float32]:
    """Depth (N, h, w) and confidence (N, h, w) that an interrupted run has computed."""
    found = spool.depth(submap_id)
    return found.depth, found.confidence.astype(np.float32) / np.float32(255)


def write_trajectory(
    recording: Recording,
    config: Config,
    drive: Drive,
    out: Path,
    seams: SeamSummary | None,
    times: MapTimes,
    quality: str = "normal",
) -> Estimate:
    """Write trajectory.tum, trajectory.kitti, summary.json and the sub-maps, with its stamps.

    quality: name of the preset.
    """
    origin_ns = recording.origin_ns
    estimate = of_recording(str(out), recording, drive.updates, config.scale.spacing_m)
    first = estimate.first_frame
    estimate = replace(
        estimate,
        t_ns=estimate.t_ns - origin_ns,
        first_frame=None if first is None else (first[0], first[1] - origin_ns),
    )
    write_tum(out / TUM, estimate.t_ns, estimate.T_w_c)
    write_kitti(out / KITTI, estimate.T_w_c)
    write_submaps(out / SUBMAPS, config, drive, origin_ns)
    content = summary(estimate) | {
        "recording": str(recording.path.resolve()),
        "submap_folder": SUBMAPS,
        "T_p_a": None if drive.trajectory is None else drive.trajectory.T_p_a.tolist(),
        "seams": asdict(seams) if seams is not None else None,
        "gaps": [asdict(gap) for gap in drive.gaps(config)],
        "map_s": times.seconds,
        "backbone": config.backbone.name,
        "quality": quality,
    }
    (out / SUMMARY).write_text(json.dumps(content, indent=2) + "\n")
    return estimate


def write_submaps(folder: Path, config: Config, drive: Drive, origin_ns: int) -> None:
    """Write the sub-maps of a map, which `export` needs: a recording may hold none, or others.

    Replaces the folder. origin_ns: of the recording. Raises RecordingError.
    """
    shutil.rmtree(folder, ignore_errors=True)
    plain = merge(config, {"recording": {"log_depth": False}})
    origin = {ORIGIN_KEY: str(origin_ns)}
    with RecordingWriter(folder, plain, origin, lossless=True) as writer:
        for update in drive.updates[:-1]:
            writer.write_update(update)
        for update in drive.updates[-1:]:
            path = drive.trajectory or update.trajectory
            writer.write_update(replace(update, trajectory=path, metre=drive.metre))
    if writer.health.error or writer.health.unwritable:
        raise RecordingError(f"{folder}: cannot be written ({writer.health.error or 'disk'})")


def summary(estimate: Estimate) -> dict[str, Any]:
    """Values that `eval` needs of a map besides its trajectory and cloud."""
    return {
        "frames": estimate.frames,
        "keyframes": estimate.keyframes,
        "submaps": estimate.submaps,
        "spacing_m": estimate.spacing_m,
        "metre": None if estimate.metre is None else estimate.metre.summary(),
        "focal_px": estimate.focal_px,
        "focal_sigma_percent": estimate.focal_sigma_percent,
        "pose_age_ms": estimate.pose_age_ms,
        "stage_ms": estimate.stage_ms,
        "first_frame": estimate.first_frame,
    }
