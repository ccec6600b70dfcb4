"""All transitions between the daemon's states."""

from __future__ import annotations

import itertools

import pytest

from calm_edge.daemon.state import Conditions, Standing, State, advance

STARTING, RUNNING, LAGGING = State.STARTING, State.RUNNING, State.LAGGING
LOST, DEGRADED, STOPPING = State.LOST, State.DEGRADED, State.STOPPING
GOOD = Conditions()
NO_POSE = Conditions(pose="no pose")
FAULT = Conditions(faults=("disk full",))
LATE = Conditions(delays=("3 windows wait to be solved",))
BOTH = Conditions(faults=("disk full",), delays=("3 windows wait to be solved",))
ALL = Conditions(False, "no pose", ("disk full",), ("3 windows wait to be solved",))
STOP = Conditions(stopping=True, pose="no pose")
AFTER_A_POSE = (RUNNING, LAGGING, LOST, DEGRADED)
SEEN = (GOOD, NO_POSE, FAULT, LATE, BOTH, ALL, STOP)

# conditions, the state that follows STARTING, and the one that follows any state after a first pose
TABLE = [
    (GOOD, RUNNING, RUNNING),
    (NO_POSE, STARTING, LOST),
    (FAULT, DEGRADED, DEGRADED),
    (LATE, LAGGING, LAGGING),
    (BOTH, DEGRADED, DEGRADED),
    (ALL, STARTING, LOST),
    (STOP, STOPPING, STOPPING),
]


@pytest.mark.parametrize(("seen", "from_start", "later"), TABLE)
def test_state_transitions(seen: Conditions, from_start: State, later: State) -> None:
    assert advance(STARTING, seen).state is from_start
    assert {advance(before, seen).state for before in AFTER_A_POSE} == {later}
    assert advance(STOPPING, seen).state is STOPPING


def test_starting_is_not_reentered_and_stopping_is_final() -> None:
    for path in itertools.product(SEEN, repeat=3):
        state = STARTING
        for seen in path:
            after = advance(state, seen).state
            assert not (state is not STARTING and after is STARTING)
            assert not (state is STOPPING and after is not STOPPING)
            state = after


def test_all_reasons_are_given_in_every_state() -> None:
    assert advance(RUNNING, ALL).reasons == ("no pose", "disk full", "3 windows wait to be solved")
    assert str(advance(RUNNING, BOTH)) == "DEGRADED (disk full; 3 windows wait to be solved)"
    assert str(Standing(RUNNING)) == "RUNNING"
