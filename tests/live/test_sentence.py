"""The state in one sentence."""

from __future__ import annotations

import pytest

from calm_edge.daemon.state import State
from calm_edge.live.sentence import BAD, GOOD, WARNING, sentence


@pytest.mark.parametrize("state", list(State))
def test_every_state_has_a_sentence_with_its_reason(state: State) -> None:
    level, text = sentence(state, [])
    assert level in (GOOD, WARNING, BAD) and text.endswith(".") and state.value not in text
    assert sentence(state, ["no frame for 2.0 s", "hot."]) == (
        level,
        f"{text[:-1]} – no frame for 2.0 s; hot.",
    )


def test_only_a_live_pose_is_good() -> None:
    assert [state for state in State if sentence(state, [])[0] == GOOD] == [State.RUNNING]


def test_what_is_not_recorded_comes_first() -> None:
    level, text = sentence("RUNNING", ["any"], "disk full")
    assert (level, text) == (BAD, "NOT recording: disk full.")
