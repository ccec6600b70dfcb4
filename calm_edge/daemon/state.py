"""State machine of the daemon: its state and the reasons for it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class State(StrEnum):
    """State of the daemon; the first that applies in the order STOPPING ... RUNNING.

    STOPPING: capturing has ended. STARTING: no live pose yet. LOST: the live pose is lost.
    DEGRADED: a part has failed, the live pose is not metric though the spacing is configured, or
    work is left out to reduce the load. LAGGING: several windows
    wait to be solved, or the capture loop misses its deadlines. RUNNING: none of these.
    """

    STARTING = "STARTING"
    RUNNING = "RUNNING"
    LAGGING = "LAGGING"
    LOST = "LOST"
    DEGRADED = "DEGRADED"
    STOPPING = "STOPPING"


@dataclass(frozen=True, slots=True)
class Conditions:
    """Problems observed in one second as texts, empty if there are none.

    pose: why there is no live pose. faults: failed parts, why the pose is not metric, and work left
    out to reduce the load.
    delays: windows that wait, or a capture loop behind its deadlines.
    """

    stopping: bool = False
    pose: str = ""
    faults: tuple[str, ...] = ()
    delays: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Standing:
    """A state, and the texts of all current problems, also of those that imply a milder state."""

    state: State
    reasons: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"{self.state} ({'; '.join(self.reasons)})" if self.reasons else str(self.state)


def advance(before: State, seen: Conditions) -> Standing:
    """Return the state after `before`, given the problems `seen`.

    STOPPING is final. STARTING lasts until the first live pose and does not return, so that a user
    can distinguish a drive without any pose from a lost pose.
    """
    reasons = (*filter(None, [seen.pose]), *seen.faults, *seen.delays)
    if seen.stopping or before is State.STOPPING:
        state = State.STOPPING
    elif seen.pose:
        state = State.STARTING if before is State.STARTING else State.LOST
    elif seen.faults:
        state = State.DEGRADED
    elif seen.delays:
        state = State.LAGGING
    else:
        state = State.RUNNING
    return Standing(state, reasons)
