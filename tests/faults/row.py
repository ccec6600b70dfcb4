"""A row of the fault table, and queries on recordings for the rows."""

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
    """Result of one fault. figure: what happened. promise: what must happen. kept: whether it did.

    skipped: the fault cannot be injected on this computer; `figure` then gives the reason, and
    `kept` has no meaning.
    """

    fault: str
    figure: str
    promise: str
    kept: bool
    skipped: bool = False


def sequences(recording: Recording, eye: Eye) -> list[int]:
    """Sequence numbers of an eye's frames in the order written."""
    return [place.sequence for place in recording._locations(schema.IMAGE_TOPICS[eye])]


def all_frames(folder: Path, n: int) -> bool:
    """Whether a valid recording holds each frame from 0 to n - 1 of both eyes once."""
    recording = Recording(folder)
    complete = all(sequences(recording, eye) == list(range(n)) for eye in Eye)
    return complete and validate(folder).outcome is not Outcome.FAILED


def health(folder: Path) -> list[dict[str, Any]]:
    """Messages on /health."""
    return list(Recording(folder).json_messages(schema.HEALTH))


def loop_figures(folder: Path) -> str:
    """Largest latency of the capture loop, reported without a limit as the computer may be busy."""
    return f"worst tick {max(m['tick']['max_ms'] for m in health(folder)):.0f} ms late"


def states(folder: Path) -> list[str]:
    """The sequence of different states."""
    met: list[str] = []
    for message in health(folder):
        if not met or met[-1] != message["state"]:
            met.append(message["state"])
    return met


def resident_bytes(pid: int | None = None) -> int:
    """Resident memory of a process in bytes; 0 if it has ended."""
    try:
        text = Path(f"/proc/{pid or 'self'}/statm").read_text(encoding="ascii")
    except OSError:
        return 0
    return int(text.split()[1]) * os.sysconf("SC_PAGE_SIZE")


class AfterFrames:
    """Call each fault once, as soon as the given number of primary frames has been recorded."""

    def __init__(self, *faults: tuple[int, Any]) -> None:
        self._faults = list(faults)

    def __call__(self, hub: Hub, _: str) -> None:
        while self._faults and hub.result.frames[0] >= self._faults[0][0]:
            self._faults.pop(0)[1](hub)
