"""Runs the real daemon on a folder, as the command line does."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from calm_edge.config import Config, merge
from calm_edge.daemon.capture import Capture
from calm_edge.daemon.result import RecordResult
from calm_edge.daemon.source import replayed
from calm_edge.daemon.switchboard import Switchboard
from calm_edge.frontend.sequence import SequenceFolder
from calm_edge.pose_output.publisher import PosePublisher
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


def record(
    folder: Path,
    out: Path,
    *,
    lockstep: bool,
    config: Config | None = None,
    during: Callable[[Switchboard, str], None] | None = None,
    publisher: PosePublisher | None = None,
) -> tuple[RecordResult, list[str]]:
    """The result and what was said. `during` sees every line said and may do harm."""
    config = config or config_for(folder)
    sequence = SequenceFolder(folder)
    epoch_ns = min(int(sequence.t_ns(eye)[0]) for eye in Eye)
    source = replayed(sequence.frames, epoch_ns, not lockstep, config, str(folder))
    said: list[str] = []
    desk = Switchboard(
        config,
        source,
        lambda: RecordingWriter(out, config, lossless=lockstep, now_ns=source.clock.now_ns),
        publisher,
        lockstep=lockstep,
        say=said.append,
    )
    capture = Capture(desk, HarmfulNotifier(desk, during) if during else NullNotifier())
    return capture.run(), said


class HarmfulNotifier(NullNotifier):
    """Calls `during` whenever the daemon says that it is alive."""

    def __init__(self, desk: Switchboard, during: Callable[[Switchboard, str], None]) -> None:
        self._desk, self._during = desk, during

    def watchdog(self) -> None:
        self._during(self._desk, "watchdog")
