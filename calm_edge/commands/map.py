"""`calm-edge map`: recording -> sub-maps -> depth -> map, trajectory, report."""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from calm_edge.commands.exit_codes import LOSS, OK

if TYPE_CHECKING:
    from calm_edge.config import Config
    from calm_edge.evaluation.estimate import Estimate
    from calm_edge.evaluation.sequences import Truth
    from calm_edge.mapping.seams import SeamSummary
    from calm_edge.offline.submaps import Drive
    from calm_edge.recording.reader import Recording
    from calm_edge.types import Bytes

MAP, TUM, KITTI, SUMMARY, REPORT = (
    "map.ply",
    "trajectory.tum",
    "trajectory.kitti",
    "summary.json",
    "report.html",
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Its arguments."""
    parser.add_argument("recording", type=Path, help="a recording folder or an MCAP file")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="a new folder")
    parser.add_argument(
        "--truth", type=Path, metavar="FOLDER", help="show the error against it in the report"
    )
    parser.add_argument("--set", action="append", default=[], metavar="SECTION.KEY=VALUE")


def run(arguments: argparse.Namespace) -> int:
    """Makes the map; exit code 3 when the recording had lost something."""
    from calm_edge.commands.record import say
    from calm_edge.config import merge, parse_assignment
    from calm_edge.evaluation.sequences import read_truth
    from calm_edge.mapping.cloud_file import read_cloud
    from calm_edge.offline.submaps import gather
    from calm_edge.recording.reader import Recording
    from calm_edge.types import CalmEdgeError

    started = time.monotonic()
    out = new_folder(arguments.out)
    truth = read_truth(arguments.truth) if arguments.truth is not None else None
    recording = Recording(arguments.recording)
    config = recording.config
    for text in arguments.set:
        config = merge(config, parse_assignment(text))
    drive = gather(recording, config, say)
    if not drive.updates or drive.trajectory is None:
        raise CalmEdgeError(
            f"{arguments.recording}: no window could be solved; nothing to map "
            f"({'; '.join(drive.losses + recording.losses) or 'too little motion or overlap'})"
        )
    out.mkdir(parents=True, exist_ok=True)
    n_points, seams = make_cloud(arguments.recording, recording, config, drive, out)
    estimate = write_trajectory(arguments.recording, config, drive, out, seams)
    points_w, color = read_cloud(out / MAP)
    estimate = replace(estimate, points_w=points_w)
    losses = [*recording.losses, *drive.losses]
    recorded = arguments.recording.resolve()
    title = f"{recorded.parent.name}/{recorded.name}"
    write_report(title, estimate, color, drive, truth, losses, out)
    print(f"map         {out / MAP} ({n_points:,} points)")
    if seams is not None:
        print(
            f"seams       {seams.n_seams}; sub-maps apart by {seams.median_before:.3g} before,"
            f" {seams.median_after:.3g} after deformation (median of {seams.n_anchors:,} anchors)"
        )
    print(f"trajectory  {out / TUM}, {out / KITTI} ({len(estimate.t_ns)} keyframes)")
    print(f"report      {out / REPORT}")
    print(f"took        {time.monotonic() - started:.0f} s")
    if drive.unsolved:
        say(f"windows {drive.unsolved} could not be solved; they are bridged")
    for line in losses:
        say(f"loss: {line}")
    return LOSS if losses else OK


def new_folder(out: Path) -> Path:
    """The output folder, which must not hold a map yet; raises CalmEdgeError."""
    from calm_edge.types import CalmEdgeError

    if out.exists() and not out.is_dir():
        raise CalmEdgeError(f"{out}: is a file; choose another output folder")
    for name in (MAP, TUM, SUMMARY, REPORT):
        if (out / name).exists():
            raise CalmEdgeError(f"{out}: already holds {name}; choose another output folder")
    return out


def make_cloud(
    path: Path, recording: Recording, config: Config, drive: Drive, out: Path
) -> tuple[int, SeamSummary | None]:
    """Depth, anchors, tiles, the PLY; how many points it has, and how well sub-maps meet."""
    from calm_edge.commands.record import say
    from calm_edge.mapping import seams
    from calm_edge.mapping.cloud_file import CloudWriter
    from calm_edge.mapping.mapper import Mapper
    from calm_edge.offline.densify import densified

    spacing = config.scale.spacing_m or 1.0
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
        return cloud.count, seams.summary(mapper.seams())


def write_trajectory(
    path: Path, config: Config, drive: Drive, out: Path, seams: SeamSummary | None
) -> Estimate:
    """trajectory.tum, trajectory.kitti and summary.json."""
    from calm_edge.evaluation.estimate import from_recording, from_updates
    from calm_edge.evaluation.trajectory_file import write_kitti
    from calm_edge.trajectories import write_tum

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
    told = summary(estimate) | {"seams": asdict(seams) if seams is not None else None}
    (out / SUMMARY).write_text(json.dumps(told, indent=2) + "\n")
    return estimate


def summary(estimate: Estimate) -> dict[str, Any]:
    """What `eval` needs to know of a map beside its trajectory and cloud."""
    return {
        "frames": estimate.frames,
        "keyframes": estimate.keyframes,
        "submaps": estimate.submaps,
        "spacing_m": estimate.spacing_m,
        "focal_px": estimate.focal_px,
        "focal_sigma_percent": estimate.focal_sigma_percent,
        "pose_age_ms": estimate.pose_age_ms,
        "stage_ms": estimate.stage_ms,
        "first_frame": estimate.first_frame,
    }


def write_report(
    title: str,
    estimate: Estimate,
    color: Bytes,
    drive: Drive,
    truth: Truth | None,
    losses: Sequence[str],
    out: Path,
) -> None:
    """report.html, with the error where there is truth. color: (P, 3) RGB of estimate.points_w."""
    from calm_edge.evaluation.drive_report import report_data
    from calm_edge.evaluation.report import write_report as write
    from calm_edge.evaluation.results import compare

    figures = compare(estimate, truth) if truth is not None else None
    data = report_data(title, estimate, drive.updates, color, truth, figures, losses)
    write(out / REPORT, data)
