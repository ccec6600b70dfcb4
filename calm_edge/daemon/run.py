"""One run of `calm-edge record`, from the check of the output folder to the trajectory file."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from calm_edge.config import Config
from calm_edge.daemon import ladder, outputs
from calm_edge.daemon.capture import Capture
from calm_edge.daemon.fan_out import Output
from calm_edge.daemon.hub import Hub
from calm_edge.daemon.result import RecordResult
from calm_edge.daemon.source import Source
from calm_edge.recording import RecordingError
from calm_edge.recording.retention import TRAJECTORY_FILE, new_drive
from calm_edge.recording.room import check_room
from calm_edge.recording.segment import segment_files
from calm_edge.recording.writer import RecordingWriter
from calm_edge.trajectories import write_tum
from calm_edge.types import CalmEdgeError
from device.errors import DeviceError
from device.service import Notifier


@dataclass(frozen=True, slots=True)
class Target:
    """Output folder of a recording.

    is_root: `folder` contains a folder per drive: a new one is created in it, and the oldest drives
    are removed when the disk is full.
    """

    folder: Path
    is_root: bool = False

    @property
    def root(self) -> Path | None:
        """Folder that contains all drives; None for a single recording."""
        return self.folder if self.is_root else None

    def check(self, config: Config) -> None:
        """Check that a recording can be made there; raises ConfigError or RecordingError."""
        if self.folder.exists() and not self.folder.is_dir():
            raise RecordingError(f"{self.folder}: is a file; choose another output folder")
        if not self.is_root and self.folder.exists() and segment_files(self.folder):
            raise RecordingError(
                f"{self.folder}: already holds a recording; choose another output folder"
            )
        ladder.check(config.degrade)
        check_room(self.folder, config.recording, self.root)


def record(
    config: Config,
    source: Source,
    target: Target,
    notifier: Notifier,
    *,
    lockstep: bool,
    say: Callable[[str], None],
    more: Sequence[Output] = (),
) -> tuple[Path, RecordResult]:
    """Record until the frames end or SIGINT or SIGTERM arrives; return the folder and the result.

    say: prints a line for the user. more: outputs besides those that are configured. Raises
    CalmEdgeError, DeviceError.
    """
    target.check(config)
    folder: Path | None = None

    def open_writer() -> RecordingWriter:
        nonlocal folder
        folder = new_drive(target.folder) if target.is_root else target.folder
        return RecordingWriter(
            folder,
            config,
            {
                "source": source.description,
                "pace": "lockstep" if lockstep else "realtime",
                # nothing in a replay that waits depends on when it is run
                **({"boot_id": ""} if lockstep else {}),
            },
            lossless=lockstep,
            root=target.root,
            time_base=source.time_base,
            now_ns=source.clock.now_ns,
        )

    consumers = outputs.configured(config, source.clock.now_ns)
    recording = outputs.RecordingOutput(open_writer)
    hub = Hub(config, source, recording, [*consumers, *more], lockstep=lockstep, say=say)
    capture = Capture(hub, notifier)
    with stopped_by_signals(capture):
        try:
            result = capture.run()
        except (CalmEdgeError, DeviceError):
            # neither an empty drive, with which systemd would fill the disk, nor part of a copy
            if folder is not None and (source.is_replay or not any(hub.result.frames)):
                discard(folder)
            raise
        assert folder is not None
        if result.trajectory is not None:
            file = folder / TRAJECTORY_FILE
            try:
                t_ns = result.trajectory.t_ns - source.time_base.origin_ns
                write_tum(file, t_ns, result.trajectory.T_w_c)
            except OSError as error:
                # e.g. the disk is full; not fatal: the recording contains the trajectory as well
                say(f"{file}: cannot be written ({error.strerror})")
        return folder, result


@contextmanager
def stopped_by_signals(capture: Capture) -> Iterator[None]:
    """Context in which signals to the process request a stop.

    SIGHUP, of a terminal that is closed, only if it is not ignored, as under nohup.
    """
    numbers = [signal.SIGINT, signal.SIGTERM]
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        numbers.append(signal.SIGHUP)
    before = {
        number: signal.signal(number, lambda *_: capture.request_stop()) for number in numbers
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def discard(folder: Path) -> None:
    """Remove the files of a recording, if there are any, and its folder unless it holds others."""
    with suppress(OSError, RecordingError):
        for file in [*segment_files(folder), folder / TRAJECTORY_FILE]:
            file.unlink(missing_ok=True)
        folder.rmdir()
