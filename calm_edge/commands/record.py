"""`calm-edge record`: cameras or a replay through the real daemon."""

from __future__ import annotations

import argparse
import logging
import shutil
import signal
from pathlib import Path
from typing import TYPE_CHECKING

from calm_edge.commands.console import say
from calm_edge.commands.exit_codes import ERROR, LOSS, OK

if TYPE_CHECKING:
    from calm_edge.config import Config
    from calm_edge.daemon.result import RecordResult
    from calm_edge.daemon.source import Source
    from device.service import Notifier


def configure(parser: argparse.ArgumentParser) -> None:
    """Its arguments."""
    parser.add_argument("--config", type=Path, metavar="TOML", help="the kit's configuration")
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
        help="where drives lie, oldest removed at the floor; this one gets a folder of its own",
    )
    parser.add_argument(
        "--pace",
        choices=("realtime", "lockstep"),
        default="realtime",
        help="realtime never waits; lockstep waits for every window and is deterministic",
    )
    parser.add_argument(
        "--spacing-m", type=float, metavar="X", help="metres between the two cameras"
    )
    parser.add_argument(
        "--hfov-deg",
        type=float,
        nargs="+",
        metavar="A",
        help="horizontal field of view, one value or one a camera: a hint, never needed",
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="SECTION.KEY=VALUE",
        help="override the configuration",
    )


def effective_config(arguments: argparse.Namespace) -> Config:
    """Defaults, file, --set, then --spacing-m and --hfov-deg, and how a model will run here.

    Raises ConfigError, BackboneError.
    """
    from calm_edge.backbones.onnx.precision import pinned
    from calm_edge.config import ConfigError, load, merge

    config = load(arguments.config, arguments.set)
    if arguments.spacing_m is not None:
        config = merge(config, {"scale": {"spacing_m": arguments.spacing_m}})
    if arguments.hfov_deg is not None:
        if len(arguments.hfov_deg) > 2:
            raise ConfigError("--hfov-deg: one value or one a camera")
        config = merge(config, {"backbone": {"hfov_deg": arguments.hfov_deg}})
    if config.scale.spacing_m < 0:
        raise ConfigError(f"scale.spacing_m = {config.scale.spacing_m:g}: must not be negative")
    if any(not 0 < a < 180 for a in config.backbone.hfov_deg):
        raise ConfigError(f"backbone.hfov_deg = {config.backbone.hfov_deg}: must be in (0, 180)")
    return pinned(config, deterministic=arguments.pace == "lockstep")


def open_source(arguments: argparse.Namespace, config: Config) -> Source:
    """The frames asked for; raises CalmEdgeError, CameraError."""
    from calm_edge.config import ConfigError
    from calm_edge.daemon.source import live, replayed
    from device.frame import Eye

    paced = arguments.pace == "realtime"
    if arguments.sequence is not None:
        from calm_edge.recording.sequence_folder import SequenceFolder

        folder = SequenceFolder(arguments.sequence)
        epoch_ns = min(int(folder.t_ns(eye)[0]) for eye in Eye)
        return replayed(folder.frames, epoch_ns, paced, config, str(arguments.sequence))
    if arguments.replay is not None:
        from calm_edge.recording.errors import RecordingError
        from calm_edge.recording.reader import Recording

        recording = Recording(arguments.replay)
        stamps = [recording.frame_times(eye) for eye in Eye]
        if not all(len(t) for t in stamps):
            raise RecordingError(f"{arguments.replay}: does not hold frames of both eyes")
        epoch_ns = min(int(t.min()) for t in stamps)
        return replayed(recording.frames, epoch_ns, paced, config, str(arguments.replay))
    if not paced:
        raise ConfigError("--pace lockstep: only of a replay; give --sequence or --replay")
    return live(config)


def check_target(arguments: argparse.Namespace, config: Config) -> None:
    """Before anything is started: raises ConfigError, RecordingError where nothing could run."""
    from calm_edge.daemon import ladder
    from calm_edge.recording.errors import RecordingError
    from calm_edge.recording.room import check_room
    from calm_edge.recording.segment import segment_files

    out: Path | None = arguments.out
    if out is not None and out.exists() and (not out.is_dir() or segment_files(out)):
        raise RecordingError(f"{out}: already holds a recording; choose another output folder")
    ladder.check(config.degrade)
    check_room(out or arguments.root, config.recording, arguments.root)


def run(arguments: argparse.Namespace) -> int:
    """Records until the frames end or SIGINT/SIGTERM."""
    from calm_edge.types import CalmEdgeError
    from device.errors import DeviceError
    from device.service import log_handler, open_notifier

    logging.basicConfig(handlers=[log_handler()], level=logging.WARNING, format="%(message)s")
    notifier = open_notifier()
    try:
        return record(arguments, notifier)
    except (CalmEdgeError, DeviceError) as error:
        # who looks at the service sees why it does not run, without reading its journal
        notifier.status(f"FAILED: {error}", "FAILED")
        raise


def record(arguments: argparse.Namespace, notifier: Notifier) -> int:
    """One run, from the configuration to the report; raises CalmEdgeError, DeviceError."""
    from calm_edge.daemon.capture import Capture
    from calm_edge.daemon.switchboard import Switchboard
    from calm_edge.pose_output.publisher import PosePublisher
    from calm_edge.recording.retention import new_drive
    from calm_edge.recording.writer import RecordingWriter
    from calm_edge.types import CalmEdgeError
    from device.errors import DeviceError
    from device.serial_port import SerialPort

    config = effective_config(arguments)
    source = open_source(arguments, config)
    check_target(arguments, config)
    out: Path | None = None
    lockstep = arguments.pace == "lockstep"
    port = publisher = None
    if config.pose_output.port:
        port = SerialPort(config.pose_output.port, config.pose_output.baud)
        publisher = PosePublisher(
            port,
            config.pose_output,
            spacing_known=config.scale.spacing_m > 0,
            lost_after_ms=config.frontend.lost_after_ms,
            now_ns=source.clock.now_ns,
        )
        port.start(publisher.receive)

    def open_writer() -> RecordingWriter:
        nonlocal out
        out = arguments.out or new_drive(arguments.root)
        metadata = {"source": source.description, "pace": arguments.pace}
        return RecordingWriter(
            out,
            config,
            metadata,
            lossless=lockstep,
            root=arguments.root,
            now_ns=source.clock.now_ns,
        )

    desk = Switchboard(config, source, open_writer, publisher, lockstep=lockstep, say=say)
    capture = Capture(desk, notifier, port)
    before = {
        number: signal.signal(number, lambda *_: capture.request_stop())
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    reasons: tuple[str, ...] = ()
    try:
        result = capture.run()
    except (CalmEdgeError, DeviceError) as error:
        reasons = (str(error),)
        if out is not None and out != arguments.out and not any(desk.result.frames):
            # a service without cameras tries again every few seconds: no empty drive each time
            shutil.rmtree(out, ignore_errors=True)
        raise
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if port is not None and publisher is not None:
            publisher.last_words(reasons, source.clock.now_ns())
            port.stop()
    assert out is not None
    return report(result, out)


def report(result: RecordResult, out: Path) -> int:
    """Writes the trajectory, says what was made and what is missing."""
    from calm_edge.recording.retention import TRAJECTORY_FILE
    from calm_edge.trajectories import write_tum

    trajectory = result.trajectory
    poses = 0 if trajectory is None else len(trajectory.t_ns)
    if trajectory is not None:
        try:
            write_tum(out / TRAJECTORY_FILE, trajectory.t_ns, trajectory.T_w_c)
        except OSError as error:
            # a full disk; the recording holds the trajectory too, as far as it was written
            say(f"{out / TRAJECTORY_FILE}: cannot be written ({error.strerror})")
    age = result.pose_age_ms()
    aged = f", age p50 {age['p50']:.0f} ms p99 {age['p99']:.0f} ms" if age else ""
    print(f"recording   {out}")
    print(f"frames      {result.frames[0]} primary, {result.frames[1]} assistant")
    print(f"sub-maps    {result.submaps} of {result.windows} windows, {poses} keyframes placed")
    print(f"live poses  {result.poses}, lost {result.lost_poses}{aged}")
    if result.unsolved_windows:
        say(f"windows {result.unsolved_windows} could not be solved; they are bridged")
    losses = result.losses()
    for line in losses:
        say(f"loss: {line}")
    if result.error:
        say(result.error)
        return ERROR
    return LOSS if losses or (result.windows and not result.submaps) else OK
