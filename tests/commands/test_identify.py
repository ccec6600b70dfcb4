from __future__ import annotations

import pytest

from calm_edge.commands.identify import POLL_NS, TIMEOUT_NS, IdentifyError, by_unplugging
from tests.manual_clock import ManualClock

A, B, C = "v4l2:usb-1", "v4l2:usb-2", "v4l2:usb-3"


class Hands:
    """Simulated user. acts: for each prompt, the addresses present at the polls after it."""

    def __init__(self, start: set[str], *acts: list[set[str]]) -> None:
        self.present, self.acts = start, list(acts)
        self.polls: list[set[str]] = []
        self.prompts: list[str] = []
        self.clock = ManualClock()

    def addresses(self) -> set[str]:
        if self.polls:
            self.present = self.polls.pop(0)
        return set(self.present)

    def say(self, line: str) -> None:
        self.prompts.append(line)
        if self.acts:
            self.polls = self.acts.pop(0)

    def identify(self) -> tuple[str, str]:
        return by_unplugging(self.addresses, self.clock, self.say)


def test_the_first_camera_unplugged_is_the_primary() -> None:
    hands = Hands({A, B}, [{A, B}, {A}], [{A}, {A, B}])
    assert hands.identify() == (B, A)
    assert len(hands.prompts) == 2 and B in hands.prompts[1]


def test_with_three_cameras_the_second_is_prompted_for_too() -> None:
    hands = Hands({A, B, C}, [{A, B}], [{A, B, C}], [{B, C}], [{A, B, C}])
    assert hands.identify() == (C, A)


def test_a_bouncing_plug_counts_once_stable() -> None:
    hands = Hands({A, B}, [{A}, {A, B}, {B}, {A, B}, {A}], [{A, B}])
    assert hands.identify() == (B, A)


@pytest.mark.parametrize("start", [set[str](), {A}])
def test_fewer_than_two_cameras_raise(start: set[str]) -> None:
    with pytest.raises(IdentifyError, match=rf"{len(start)} camera\(s\) found, two are needed"):
        Hands(start).identify()


def test_two_unplugged_together_raise() -> None:
    with pytest.raises(IdentifyError, match="vanished together"):
        Hands({A, B, C}, [{C}]).identify()


def test_the_primary_unplugged_again_raises() -> None:
    with pytest.raises(IdentifyError, match="is the primary already"):
        Hands({A, B, C}, [{B, C}], [{A, B, C}], [{B, C}]).identify()


def test_identify_times_out() -> None:
    hands = Hands({A, B})
    with pytest.raises(IdentifyError, match="no change within 300 s"):
        hands.identify()
    assert TIMEOUT_NS <= hands.clock.now_ns() <= TIMEOUT_NS + POLL_NS
