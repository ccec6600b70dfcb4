"""State of the daemon, with reasons: a pure state machine."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class State(StrEnum):
    """STARTING: no pose yet. LOST: no pose any more. DEGRADED: something is missing or left out.

    LAGGING: nothing is missing, but something is late. The worst condition that holds is the state.
    """

    STARTING = "STARTING"
    RUNNING = "RUNNING"
    LAGGING = "LAGGING"
    LOST = "LOST"
    DEGRADED = "DEGRADED"
    STOPPING = "STOPPING"


@dataclass(frozen=True, slots=True)
class Conditions:
    """Observations of one second, each empty when all is well.

    pose: why there is no live pose. faults: what is missing or left out. delays: what is behind.
    """

    stopping: bool = False
    pose: str = ""
    faults: tuple[str, ...] = ()
    delays: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Standing:
    """A state with all reasons that hold, not only those of the state."""

    state: State
    reasons: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"{self.state} ({'; '.join(self.reasons)})" if self.reasons else str(self.state)


def advance(before: State, seen: Conditions) -> Standing:
    """The state that follows `before` under the conditions `seen`.

    STOPPING is final. STARTING lasts until the first live pose and does not return: a user must be
    able to distinguish a lost pose from one that never was.
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
