"""`calm-edge record`: record cameras or a replay, with live poses."""

from __future__ import annotations

import argparse
import logging
from pathlib import Path
from typing import TYPE_CHECKING

from calm_edge.commands.configuration import add_configuration, effective_config
from calm_edge.commands.console import print_metre, say, say_no_metre
from calm_edge.commands.exit_codes import ERROR, LOSS, OK

if TYPE_CHECKING:
    from calm_edge.config import Config
    from calm_edge.daemon.result import RecordResult
    from calm_edge.daemon.source import Source
    from calm_edge.recording.reader import Recording


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    source = parser.add_mutually_exclusive_group()
    source.add_argument(
        "--sequence", type=Path, metavar="FOLDER", help="replay cam0/ cam1/ (png, jpg) of a folder"
    )
    source.add_argument(
        "--replay", type=Path, metavar="REC", help="replay the frames of a recording"
    )
    target = parser.add_mutually_exclusive_group(required=True)
    target.add_argument("--out", type=Path, metavar="DIR", help="a new folder")
    target.add_argument(
        "--root",
        type=Path,
        metavar="DIR",
        help="folder of all drives: make a new one in it, remove the oldest when the disk is full",
    )
    parser.add_argument(
        "--pace",
        choices=("realtime", "lockstep"),
        default="realtime",
        help="realtime: never wait; lockstep: wait for every window, deterministic",
    )
    parser.add_argument(
        "--no-report",
        action="store_true",
        help="do not write report.html at the end; `calm-edge report` does it later. As a service: "
        "never at the end",
    )
    parser.add_argument(
        "--live", action="store_true", help="offer the results to the page of `calm-edge live`"
    )
    add_configuration(parser)


def recorded_config(recording: Recording) -> Config:
    """Configuration to replay a recording with: its own, but for what a replay must not touch.

    That is the serial ports, the live page's socket, and the kit file, which may hold what this
    drive has shown.
    """
    from calm_edge.config import Config, merge
    from calm_edge.types import CalmEdgeError

    try:
        config = recording.config
    except CalmEdgeError as error:
        say(f"{error}; the defaults are used")
        return Config()
    spacing = config.scale.spacing_m
    distance = f"{spacing:g} m apart" if spacing else "no spacing"
    say(
        f"configuration of {recording.path}: {config.backbone.name}, cameras {distance}; options "
        "override it"
    )
    own = {"pose_output": {"port": ""}, "backbone": {"kit_file": ""}, "gps": {"source": ""}}
    return merge(config, own | {"live": {"socket": ""}})


def open_source(
    arguments: argparse.Namespace, config: Config, recording: Recording | None
) -> Source:
    """Open the source of frames, cameras or a replay; raises CalmEdgeError, CameraError.

    recording: opened for --replay.
    """
    from calm_edge.config import ConfigError
    from calm_edge.daemon import source

    paced = arguments.pace == "realtime"
    if arguments.sequence is not None:
        found = source.of_sequence(arguments.sequence, paced)
    elif recording is not None:
        found = source.of_recording(recording, paced)
    elif not paced:
        raise ConfigError("--pace lockstep: needs a replay; add --sequence or --replay")
    else:
        found = source.live(config)
    return source.with_gps(found, config.gps)


def run(arguments: argparse.Namespace) -> int:
    """Record until the frames end or until SIGINT or SIGTERM."""
    from calm_edge.commands.calibration_file import refuse_other_sizes
    from calm_edge.commands.live_block import terminal_output
    from calm_edge.commands.mask_file import refuse_other_shapes
    from calm_edge.config import merge
    from calm_edge.daemon.run import Target, record
    from calm_edge.live.socket_path import default_socket
    from calm_edge.recording.reader import Recording
    from calm_edge.types import CalmEdgeError
    from device.errors import DeviceError
    from device.service import NullNotifier, log_handler, open_notifier

    logging.basicConfig(handlers=[log_handler()], level=logging.WARNING, format="%(message)s")
    notifier = open_notifier()
    try:
        recording = base = None
        if arguments.replay is not None:
            recording = Recording(arguments.replay)
            base = recorded_config(recording)
        config = effective_config(arguments, base)
        if arguments.live and not config.live.socket:
            config = merge(config, {"live": {"socket": str(default_socket())}})
        source = open_source(arguments, config, recording)
        refuse_other_sizes(config, arguments.sequence, recording)
        refuse_other_shapes(config, arguments.sequence, recording)
        target = Target(arguments.out or arguments.root, is_root=arguments.out is None)
        lockstep = arguments.pace == "lockstep"
        # a service manager shows the state itself
        shown = terminal_output(config) if isinstance(notifier, NullNotifier) else None
        folder, result = record(
            config,
            source,
            target,
            notifier,
            lockstep=lockstep,
            say=say if shown is None else shown.say_line,
            more=[] if shown is None else [shown],
        )
        code = report(folder, result)
    except (CalmEdgeError, DeviceError) as error:
        # shows the error in `systemctl status`
        notifier.status(f"FAILED: {error}", "FAILED")
        raise
    # the car's computer may be switched off as soon as the recording is closed
    if isinstance(notifier, NullNotifier) and not (arguments.no_report or result.error):
        write_page(folder)
    if recording is not None and recording.losses:
        more = f", and {len(recording.losses) - 1} more" if len(recording.losses) > 1 else ""
        say(f"loss: the recording that was replayed lacks parts: {recording.losses[0]}{more}")
        return code or LOSS
    return code


def write_page(folder: Path) -> None:
    """Write report.html of the finished recording; a failure is said and changes nothing else."""
    from calm_edge.commands.report import write_report
    from calm_edge.recording.retention import REPORT_FILE

    try:
        write_report(folder, folder / REPORT_FILE)
    except Exception as error:
        # the recording is complete, whatever the page makes of it
        logging.getLogger(__name__).debug("report", exc_info=True)
        say(f"no report was written ({' '.join(str(error).split())}): calm-edge report {folder}")
        return
    print(f"report      {folder / REPORT_FILE}")


def report(folder: Path, result: RecordResult) -> int:
    """Print the counts of recorded and lost items and the metre; return the exit code."""
    poses = 0 if result.trajectory is None else len(result.trajectory.t_ns)
    age = result.pose_age_ms()
    aged = f", age p50 {age['p50']:.0f} ms p99 {age['p99']:.0f} ms" if age else ""
    print(f"recording   {folder}")
    print(f"frames      {result.frames[0]} primary, {result.frames[1]} assistant")
    print(f"sub-maps    {result.submaps} of {result.windows} windows, {poses} keyframes placed")
    unscaled = f", not metric {result.unscaled_poses}" if result.unscaled_poses else ""
    print(f"live poses  {result.poses}{unscaled}, lost {result.lost_poses}{aged}")
    if any(result.repeated):
        primary, assistant = result.repeated
        print(f"repeated    {primary} primary, {assistant} assistant pictures: no poses of these")
    if result.gps_fixes:
        print(f"GPS         {result.gps_fixes} fixes")
    print_metre(result.metre, result.spacing_m)
    moved, late = result.clamped_stamps, result.host_stamped
    if moved or late:
        print(f"stamps      {moved} moved to be in order and not in the future, {late} on arrival")
    for name, lost in result.output_losses.items():
        if lost:
            say(f"{name}: {lost} messages not sent; they are in the recording")
    losses = result.losses()
    for line in losses:
        say(f"loss: {line}")
    if result.error:
        say(result.error)
        return ERROR
    if no_metre := result.no_metre():
        say_no_metre(no_metre)
    return LOSS if losses or (no_metre and not result.stood) else OK
