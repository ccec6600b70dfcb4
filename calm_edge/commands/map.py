"""`calm-edge map`: build a dense map, a trajectory and a report from a recording."""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from calm_edge.commands.console import LOSS, OK, print_metre, say_no_metre

if TYPE_CHECKING:
    from calm_edge.evaluation.estimate import Estimate
    from calm_edge.evaluation.truth import Truth
    from calm_edge.offline.drive import Drive
    from calm_edge.types import Bytes


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("recording", type=Path, help="a recording folder or an MCAP file")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="a new folder")
    parser.add_argument(
        "--truth", type=Path, metavar="FOLDER", help="report the error against this ground truth"
    )
    parser.add_argument("--set", action="append", default=[], metavar="SECTION.KEY=VALUE")


def run(arguments: argparse.Namespace) -> int:
    """Build the map; return 3 if the recording has losses, or a spacing but no metre."""
    from calm_edge.commands.console import say
    from calm_edge.config import merge, parse_assignment
    from calm_edge.estimator.metre import NO_WINDOW
    from calm_edge.evaluation.truth import read_truth
    from calm_edge.mapping.cloud_file import read_cloud
    from calm_edge.offline.map_drive import KITTI, MAP, REPORT, TUM, make_cloud, write_trajectory
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
        reasons = drive.losses + recording.losses
        if drive.metre.reason not in ("", NO_WINDOW):
            reasons.append(drive.metre.reason)
        raise CalmEdgeError(
            f"{arguments.recording}: no window could be solved; nothing to map "
            f"({'; '.join(reasons) or 'too little motion or overlap'})"
        )
    out.mkdir(parents=True, exist_ok=True)
    n_points, seams = make_cloud(arguments.recording, recording, config, drive, out, say)
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
    print_metre(drive.metre, config.scale.spacing_m)
    print(f"report      {out / REPORT}")
    print(f"took        {time.monotonic() - started:.0f} s")
    if drive.unsolved:
        say(f"windows {drive.unsolved} could not be solved; constant velocity is assumed")
    for line in losses:
        say(f"loss: {line}")
    no_metre = bool(config.scale.spacing_m) and not drive.metre.metric
    if no_metre:
        say_no_metre(drive.metre.reason)
    return LOSS if losses or no_metre else OK


def new_folder(out: Path) -> Path:
    """Check that the output folder holds no map yet; raises CalmEdgeError."""
    from calm_edge.offline.map_drive import MAP, REPORT, SUMMARY, TUM
    from calm_edge.types import CalmEdgeError

    if out.exists() and not out.is_dir():
        raise CalmEdgeError(f"{out}: is a file; choose another output folder")
    for name in (MAP, TUM, SUMMARY, REPORT):
        if (out / name).exists():
            raise CalmEdgeError(f"{out}: already holds {name}; choose another output folder")
    return out


def write_report(
    title: str,
    estimate: Estimate,
    color: Bytes,
    drive: Drive,
    truth: Truth | None,
    losses: Sequence[str],
    out: Path,
) -> None:
    """Write report.html, including the trajectory error if truth is given.

    color: (P, 3) RGB of the points.
    """
    from calm_edge.evaluation.results import compare
    from calm_edge.offline.map_drive import REPORT
    from calm_edge.report.drive_report import report_data
    from calm_edge.report.report import write_report as write

    figures = compare(estimate, truth) if truth is not None else None
    data = report_data(title, estimate, drive.updates, color, truth, figures, losses)
    write(out / REPORT, data)
