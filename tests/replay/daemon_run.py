"""Runs the real daemon on a folder, as the command line does."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from calm_edge.config import Config, merge
from calm_edge.daemon.capture import Capture
from calm_edge.daemon.monitor import SerialLine
from calm_edge.daemon.result import RecordResult
from calm_edge.daemon.source import Source, replayed
from calm_edge.daemon.switchboard import Switchboard
from calm_edge.pose_output.publisher import PosePublisher
from calm_edge.recording.segment import Write
from calm_edge.recording.sequence_folder import SequenceFolder
from calm_edge.recording.writer import RecordingWriter
from device.frame import Eye
from device.service import NullNotifier


def config_for(folder: Path, **frontend: int) -> Config:
    return merge(
        Config(),
        {
            "backbone": {"name": f"scripted:{folder}"},
            "scale": {"spacing_m": 0.5},
            "frontend": {"n_max": 6, "n_overlap": 2, **frontend},
        },
    )


def source_of(folder: Path, config: Config, *, paced: bool) -> Source:
    sequence = SequenceFolder(folder)
    epoch_ns = min(int(sequence.t_ns(eye)[0]) for eye in Eye)
    return replayed(sequence.frames, epoch_ns, paced, config, str(folder))


def record(
    folder: Path,
    out: Path,
    *,
    lockstep: bool,
    config: Config | None = None,
    during: Callable[[Switchboard, str], None] | None = None,
    publisher: PosePublisher | None = None,
    serial: SerialLine | None = None,
    source: Source | None = None,
    root: Path | None = None,
    queue_bytes: int = 128 << 20,
    write: Write = os.write,
) -> tuple[RecordResult, list[str]]:
    """The result and what was said. `during` sees every status, and every tick that had a frame or
    a pose as "watchdog", and may do harm.
    """
    config = config or config_for(folder)
    source = source or source_of(folder, config, paced=not lockstep)
    now_ns = source.clock.now_ns
    said: list[str] = []
    desk = Switchboard(
        config,
        source,
        lambda: RecordingWriter(
            out,
            config,
            lossless=lockstep,
            root=root,
            queue_bytes=queue_bytes,
            now_ns=now_ns,
            write=write,
        ),
        publisher,
        lockstep=lockstep,
        say=said.append,
    )
    notifier = HarmfulNotifier(desk, during) if during else NullNotifier()
    capture = Capture(desk, notifier, serial)
    return capture.run(), said


class HarmfulNotifier(NullNotifier):
    """Calls `during` whenever the daemon says that it is alive."""

    def __init__(self, desk: Switchboard, during: Callable[[Switchboard, str], None]) -> None:
        self._desk, self._during = desk, during

    def watchdog(self) -> None:
        self._during(self._desk, "watchdog")

    def status(self, text: str, state: str = "") -> None:
        self._during(self._desk, text)
