"""Write the outputs of `map`: point cloud, trajectory and summary."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from calm_edge.config import Config
from calm_edge.evaluation.estimate import Estimate, from_recording, from_updates
from calm_edge.mapping.cloud_file import CloudWriter
from calm_edge.mapping.mapper import Mapper
from calm_edge.mapping.seams import SeamSummary
from calm_edge.mapping.seams import summary as seam_summary
from calm_edge.offline.densify import densified
from calm_edge.offline.drive import Drive
from calm_edge.recording.reader import Recording
from calm_edge.trajectories import write_kitti, write_tum

MAP, TUM, KITTI, SUMMARY, REPORT = (
    "map.ply",
    "trajectory.tum",
    "trajectory.kitti",
    "summary.json",
    "report.html",
)


def make_cloud(
    path: Path,
    recording: Recording,
    config: Config,
    drive: Drive,
    out: Path,
    say: Callable[[str], None],
) -> tuple[int, SeamSummary | None]:
    """Compute depth and anchors of all sub-maps and write map.ply.

    Returns the number of points, and statistics of the distances between sub-maps' positions of
    common anchors.
    """
    spacing = config.scale.spacing
    n = len(drive.updates)
    with tempfile.TemporaryDirectory(prefix="spool-", dir=out) as spool:
        mapper = Mapper(config.mapping, spacing, Path(spool), config.backbone.seed)
        depths = densified(path, config, drive.windows, drive.updates)
        for k, (record, update, depth) in enumerate(
            zip(drive.windows, drive.updates, depths, strict=True), 1
        ):
            if isinstance(depth, str):
                drive.losses.append(depth)
                continue
            window = recording.window(record)
            images = [keyframe.frame.bgr() for keyframe in window.keyframes()]
            mapper.add(update.submap, *depth, images)
            say(f"depth and anchors: {k} of {n} sub-maps")
        with CloudWriter(out / MAP) as cloud:
            for tile in mapper.finish():
                cloud.write(tile)
        return cloud.count, seam_summary(mapper.seams())


def write_trajectory(
    path: Path, config: Config, drive: Drive, out: Path, seams: SeamSummary | None
) -> Estimate:
    """Write trajectory.tum, trajectory.kitti and summary.json."""
    logged = from_recording(path)
    estimate = from_updates(
        str(out),
        drive.updates,
        logged.frames,
        config.scale.spacing_m,
        logged.pose_age_ms,
        logged.first_frame,
    )
    write_tum(out / TUM, estimate.t_ns, estimate.T_w_c)
    write_kitti(out / KITTI, estimate.T_w_c)
    content = summary(estimate) | {"seams": asdict(seams) if seams is not None else None}
    (out / SUMMARY).write_text(json.dumps(content, indent=2) + "\n")
    return estimate


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
