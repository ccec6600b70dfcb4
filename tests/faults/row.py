"""One row of the fault table, and what the rows ask of a recording."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from calm_edge.daemon.hub import Hub
from calm_edge.recording import schema
from calm_edge.recording.reader import Recording
from calm_edge.recording.recovery import Outcome, validate
from device.frame import Eye


@dataclass(frozen=True, slots=True)
class Row:
    """fault: what was done. figure: what came of it. promise: what was to come. kept: it did.

    skipped: it could not be tried here; figure then says why, and kept says nothing.
    """

    fault: str
    figure: str
    promise: str
    kept: bool
    skipped: bool = False


def sequences(recording: Recording, eye: Eye) -> list[int]:
    """The sequence numbers of an eye's frames in the order written."""
    return [place.sequence for place in recording._locations(schema.IMAGE_TOPICS[eye])]


def all_frames(folder: Path, n: int) -> bool:
    """Both eyes have every frame from 0 to n - 1 once, in a recording that is whole."""
    recording = Recording(folder)
    complete = all(sequences(recording, eye) == list(range(n)) for eye in Eye)
    return complete and validate(folder).outcome is not Outcome.FAILED


def health(folder: Path) -> list[dict[str, Any]]:
    """The messages on /health."""
    return list(Recording(folder).json_messages(schema.HEALTH))


def loop_figures(folder: Path) -> str:
    """The capture loop's worst latency; reported, not judged: other work may share the cores."""
    return f"worst tick {max(m['tick']['max_ms'] for m in health(folder)):.0f} ms late"


def states(folder: Path) -> list[str]:
    """The states met, in order, each change once."""
    met: list[str] = []
    for message in health(folder):
        if not met or met[-1] != message["state"]:
            met.append(message["state"])
    return met


def resident_bytes(pid: int | None = None) -> int:
    """Resident memory of a process; 0 when it is gone."""
    try:
        text = Path(f"/proc/{pid or 'self'}/statm").read_text(encoding="ascii")
    except OSError:
        return 0
    return int(text.split()[1]) * os.sysconf("SC_PAGE_SIZE")


class AfterFrames:
    """Does each harm once, as soon as so many primary frames were recorded."""

    def __init__(self, *harms: tuple[int, Any]) -> None:
        self._harms = list(harms)

    def __call__(self, hub: Hub, _: str) -> None:
        while self._harms and hub.result.frames[0] >= self._harms[0][0]:
            self._harms.pop(0)[1](hub)
