"""`calm-edge map`: build a dense map, a trajectory and a report from a recording."""

from __future__ import annotations

import argparse
import os
import shutil
import time
from contextlib import nullcontext
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

from calm_edge.commands.configuration import add_set
from calm_edge.commands.console import messages_of, print_metre, say, say_no_metre
from calm_edge.commands.drive_reference import only
from calm_edge.commands.exit_codes import LOSS, OK
from calm_edge.commands.map_pages import Options
from calm_edge.processes import CHILD_ENVIRONMENT, interrupted_by_sigterm

if TYPE_CHECKING:
    from calm_edge.config import Config
    from calm_edge.evaluation.estimate import Estimate
    from calm_edge.evaluation.truth import Truth
    from calm_edge.mapping.seams import SeamSummary
    from calm_edge.offline.drive import Drive
    from calm_edge.offline.gps_fixes import GpsFixes
    from calm_edge.offline.map_times import MapTimes
    from calm_edge.offline.unfinished import Unfinished
    from calm_edge.recording.reader import Recording
    from calm_edge.report.map_page import Written


# frames of each camera that are looked at when nothing can be mapped
EXAMINED = 600


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "recording",
        type=Path,
        nargs="+",
        metavar="REC",
        help="a recording folder or an MCAP file; several drives of one place become one map",
    )
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="a new folder")
    parser.add_argument(
        "--truth",
        type=Path,
        action="append",
        default=[],
        metavar="FOLDER",
        help="report the error against this ground truth; of several drives, once for each",
    )
    parser.add_argument(
        "--gps",
        type=Path,
        action="append",
        default=[],
        metavar="FILE",
        help="GPS fixes (GPX, NMEA) to align the trajectory to, instead of the recorded ones; of "
        "several drives, once for each, or once if the file has the fixes of all",
    )
    parser.add_argument(
        "--quality",
        choices=("preview", "normal", "fine"),
        default="normal",
        help="preview: fewer and smaller depth maps, in about a fifth of the time; fine: larger "
        "ones and more points, in more than twice the time",
    )
    parser.add_argument(
        "--rerun-model",
        metavar="NAME",
        help="solve all windows again with this backbone or model, and map what it gives",
    )
    add_set(parser)
    shown = parser.add_mutually_exclusive_group()
    shown.add_argument(
        "--no-pictures",
        action="store_true",
        help="no pictures of the cameras in map.html and report.html",
    )
    shown.add_argument(
        "--blur",
        action="store_true",
        help="make faces and number plates in these unreadable: best effort, by OpenCV's detectors",
    )
    parser.add_argument(
        "--blur-models",
        type=Path,
        metavar="DIR",
        help="folder of OpenCV's Haar cascades; default: that of the package opencv-data",
    )
    parser.add_argument(
        "--part",
        action="store_true",
        help="only solve the drive and compute its depth, to be joined with others",
    )
    parser.add_argument(
        "--dask",
        metavar="ADDRESS",
        help="do the work on each of several drives on the cluster of this Dask scheduler",
    )
    again = parser.add_mutually_exclusive_group()
    again.add_argument(
        "--force", action="store_true", help="replace the map that is in the output folder"
    )
    again.add_argument("--resume", action="store_true", help="continue a map that was interrupted")


def run(arguments: argparse.Namespace) -> int:
    """Build the map; return 3 if something is missing in it, or nothing can be mapped."""
    # before NumPy is loaded: threads of one solver in two processes hinder each other
    os.environ.update(CHILD_ENVIRONMENT)

    from calm_edge.backbones.registry import open_backbone
    from calm_edge.config import merge, parse_assignment
    from calm_edge.evaluation.truth import read_truth
    from calm_edge.offline.gps_fixes import fixes_of
    from calm_edge.offline.map_times import MapTimes
    from calm_edge.offline.quality import PRESETS
    from calm_edge.offline.unfinished import Unfinished, plan
    from calm_edge.recording.reader import Recording
    from calm_edge.report.blur import Blur
    from calm_edge.types import CalmEdgeError

    # what cannot be done is said before anything is computed
    blur = Blur(arguments.blur_models) if arguments.blur else None
    options = Options(arguments.quality, not arguments.no_pictures, blur)
    if len(arguments.recording) > 1:
        return several(arguments, options)
    (path,) = arguments.recording
    out: Path = arguments.out
    unfinished = check_folder(out, force=arguments.force, resume=arguments.resume)
    folder = only(arguments.truth, "truth")
    truth = read_truth(folder) if folder is not None else None
    recording = Recording(path)
    recording.check_cameras()
    fixes = fixes_of(recording, only(arguments.gps, "gps"))
    again = arguments.rerun_model is not None
    config = merge(recording.config, PRESETS[arguments.quality])
    if again:
        config = merge(config, {"backbone": {"name": arguments.rerun_model}})
    for text in arguments.set:
        config = merge(config, parse_assignment(text))
    if again:
        # a model that is refused leaves nothing behind
        open_backbone(config)
    if arguments.force:
        shutil.rmtree(unfinished, ignore_errors=True)
    leftover = unfinished if out.exists() else out
    made_of = plan(path, config, again=again)
    named = messages_of(out.name) if arguments.part else nullcontext()
    with named, interrupted_by_sigterm(), Unfinished(unfinished, config, made_of) as work:
        try:
            started = time.monotonic()
            times = MapTimes()
            with times.stage("solving and placing windows"):
                drive = placed_drive(recording, config, work, again=again)
            if drive is None:
                shutil.rmtree(leftover)
                return LOSS
            if arguments.part:
                from calm_edge.offline.drive_part import write_part

                return LOSS if write_part(recording, config, drive, out, work, say) else OK
            code = make_map(recording, config, work, drive, out, truth, fixes, times, options)
            print(f"took        {time.monotonic() - started:.0f} s")
            return code
        except (KeyboardInterrupt, CalmEdgeError):
            say(f"what was computed is in {unfinished}; continue with --resume")
            raise


def several(arguments: argparse.Namespace, options: Options) -> int:
    """Map several drives; raises CalmEdgeError for options that are for one."""
    from calm_edge.commands import map_drives
    from calm_edge.types import CalmEdgeError

    for option in ("part", "rerun_model"):
        if getattr(arguments, option):
            name = option.replace("_", "-")
            raise CalmEdgeError(f"--{name}: is for a map of one recording")
    check_folder(arguments.out, force=arguments.force, resume=arguments.resume)
    return map_drives.run(arguments, options)


def make_map(
    recording: Recording,
    config: Config,
    work: Unfinished,
    drive: Drive,
    out: Path,
    truth: Truth | None,
    fixes: GpsFixes | None,
    times: MapTimes,
    options: Options,
) -> int:
    """Compute the depth, write all files and print what was written; return the exit code.

    Raises CalmEdgeError; what was computed is then in `work`.
    """
    from calm_edge.commands.map_pages import drive_view, write_report
    from calm_edge.mapping.cloud_file import read_cloud
    from calm_edge.mapping.seams import summary
    from calm_edge.offline.georeference import ENU_TUM, GPS_SUMMARY, georeference
    from calm_edge.offline.map_drive import MAP, PAGE, make_cloud, write_trajectory
    from calm_edge.report.map_page import write_map_page

    tiles, found = make_cloud(recording, config, drive, out, work.spool, say, times)
    seams = summary(found)
    n_points = int(tiles[:, 1].sum())
    estimate = write_trajectory(recording, config, drive, out, seams, times, options.quality)
    for name in (ENU_TUM, GPS_SUMMARY):
        # of a map that is replaced
        (out / name).unlink(missing_ok=True)
    if fixes is not None and georeference(estimate, fixes, out, say):
        print(f"GPS         {out / ENU_TUM}, {out / GPS_SUMMARY}")
    points_w, color = read_cloud(out / MAP)
    estimate = replace(estimate, points_w=points_w)
    losses = [*recording.losses, *drive.missing(config)]
    if not n_points:
        losses.append("the map has no points: no depth was found in any sub-map")
    with times.stage("map.html"):
        view = drive_view(recording, config, drive, estimate, color, tiles, found, options)
        page = write_map_page(out / PAGE, view)
    losses += write_report(recording, drive, estimate, color, truth, losses, out, times, options)
    if options.blur is not None:
        say(str(options.blur))
    work.remove()
    print_files(out, n_points, seams, estimate, page)
    print_metre(drive.metre, config.scale.spacing_m)
    for line in losses:
        say(f"loss: {line}")
    no_metre = bool(config.scale.spacing_m) and not drive.metre.metric
    if no_metre:
        say_no_metre(drive.metre.reason)
    return LOSS if losses or no_metre else OK


def placed_drive(
    recording: Recording, config: Config, work: Unfinished, *, again: bool = False
) -> Drive | None:
    """The sub-maps of a drive in their final placement; None, with a message, without any.

    again: solve all windows, also those that `record` solved.
    """
    from calm_edge.estimator.metre import NO_WINDOW
    from calm_edge.offline.submaps import gather

    drive = work.placed()
    if drive is not None:
        say("all sub-maps were placed by an interrupted run")
        return drive
    drive = gather(recording, config, say, work, again=again)
    if not drive.updates or drive.trajectory is None:
        reasons = drive.losses + recording.losses
        if drive.metre.reason not in ("", NO_WINDOW):
            reasons.append(drive.metre.reason)
        say(
            f"{recording.path}: no window could be solved; nothing to map "
            f"({'; '.join(reasons) or pictures_say(recording) or 'too little motion or overlap'})"
        )
        return None
    work.place(drive)
    return drive


def pictures_say(recording: Recording) -> str:
    """What is wrong with the first pictures of a recording; empty if nothing is found."""
    from calm_edge.daemon.picture_samples import PictureSamples
    from device.frame import Eye

    samples = PictureSamples()
    for eye in Eye:
        for frame in islice(recording.frames(eye), EXAMINED):
            samples.add(frame)
    return "; ".join(cause.text for cause in samples.causes())


def check_folder(out: Path, *, force: bool, resume: bool) -> Path:
    """Check that the output folder holds no map yet; return its folder of unfinished work.

    force: it may hold a map. resume: it may hold an unfinished one. Raises CalmEdgeError.
    """
    from calm_edge.offline.map_drive import OUTPUTS
    from calm_edge.offline.unfinished import FOLDER
    from calm_edge.types import CalmEdgeError

    if out.exists() and not out.is_dir():
        raise CalmEdgeError(f"{out}: is a file; choose another output folder")
    unfinished = out / FOLDER
    if force:
        return unfinished
    if unfinished.exists():
        if not resume:
            raise CalmEdgeError(
                f"{out}: holds an unfinished map; continue it with --resume, or replace it with "
                "--force"
            )
        return unfinished
    for name in OUTPUTS:
        if (out / name).exists():
            raise CalmEdgeError(
                f"{out}: already holds {name}; replace it with --force, or choose another output "
                "folder"
            )
    return unfinished


def print_files(
    out: Path, n_points: int, seams: SeamSummary | None, estimate: Estimate, page: Written
) -> None:
    """Print what was written."""
    from calm_edge.offline.map_drive import KITTI, MAP, PAGE, REPORT, TUM

    print(f"map         {out / MAP} ({n_points:,} points)")
    if seams is not None:
        print(f"seams       {seams}")
    print(f"trajectory  {out / TUM}, {out / KITTI} ({len(estimate.t_ns)} keyframes)")
    print(f"walk        {out / PAGE} ({page})")
    print(f"report      {out / REPORT}")
