"""Run the real daemon on a sequence folder, as the command line does."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path

from calm_edge.config import Config, merge
from calm_edge.daemon.capture import Capture
from calm_edge.daemon.fan_out import Output
from calm_edge.daemon.hub import Hub
from calm_edge.daemon.outputs import RecordingOutput
from calm_edge.daemon.result import RecordResult
from calm_edge.daemon.source import Source, of_sequence
from calm_edge.recording.segment import Write
from calm_edge.recording.writer import RecordingWriter
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
    during: Callable[[Hub, str], None] | None = None,
    outputs: Sequence[Output] = (),
    source: Source | None = None,
    root: Path | None = None,
    queue_bytes: int = 128 << 20,
    write: Write = os.write,
) -> tuple[RecordResult, list[str]]:
    """Record a folder; return the result and the lines for the user.

    during: called with every status text, and with "watchdog" at every tick that had a frame or a
    pose; it may inject faults.
    """
    config = config or config_for(folder)
    source = source or of_sequence(folder, not lockstep)
    now_ns = source.clock.now_ns
    lines: list[str] = []
    recording = RecordingOutput(
        lambda: RecordingWriter(
            out,
            config,
            lossless=lockstep,
            root=root,
            queue_bytes=queue_bytes,
            now_ns=now_ns,
            write=write,
        )
    )
    hub = Hub(config, source, recording, outputs, lockstep=lockstep, say=lines.append)
    notifier = CallbackNotifier(hub, during) if during else NullNotifier()
    return Capture(hub, notifier).run(), lines


class CallbackNotifier(NullNotifier):
    """Call `during` with each message to the service manager."""

    def __init__(self, hub: Hub, during: Callable[[Hub, str], None]) -> None:
        self._hub, self._during = hub, during

    def watchdog(self) -> None:
        self._during(self._hub, "watchdog")

    def status(self, text: str, state: str = "") -> None:
        self._during(self._hub, text)
