"""What the daemon is doing, in one word with reasons: a pure state machine."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class State(StrEnum):
    """STARTING: no pose yet. LOST: none any more. DEGRADED: something is missing or was shed.

    LAGGING: all is there, but late. The worst one that holds is the state.
    """

    STARTING = "STARTING"
    RUNNING = "RUNNING"
    LAGGING = "LAGGING"
    LOST = "LOST"
    DEGRADED = "DEGRADED"
    STOPPING = "STOPPING"


@dataclass(frozen=True, slots=True)
class Conditions:
    """What was seen, each an empty text or tuple where all is well.

    pose: why there is no live pose. faults: what is missing or shed. lateness: what is behind.
    """

    stopping: bool = False
    pose: str = ""
    faults: tuple[str, ...] = ()
    lateness: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Standing:
    """A state and why; every reason that holds is given, not only those of the state."""

    state: State
    reasons: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"{self.state} ({'; '.join(self.reasons)})" if self.reasons else str(self.state)


def advance(before: State, seen: Conditions) -> Standing:
    """The state after `before` once `seen` is seen.

    STOPPING is never left. STARTING lasts until the first live pose and never comes back: a pose
    that goes later is LOST, which the user must be able to tell from one that never was.
    """
    reasons = (*filter(None, [seen.pose]), *seen.faults, *seen.lateness)
    if seen.stopping or before is State.STOPPING:
        state = State.STOPPING
    elif seen.pose:
        state = State.STARTING if before is State.STARTING else State.LOST
    elif seen.faults:
        state = State.DEGRADED
    elif seen.lateness:
        state = State.LAGGING
    else:
        state = State.RUNNING
    return Standing(state, reasons)
