from __future__ import annotations

import pytest

from calm_edge.commands.identify import PATIENCE_NS, POLL_NS, IdentifyError, by_unplugging
from device.clock import ManualClock

A, B, C = "v4l2:usb-1", "v4l2:usb-2", "v4l2:usb-3"


class Hands:
    """Somebody at the cameras: at each prompt, a list of what is there in the looks that follow."""

    def __init__(self, start: set[str], *acts: list[set[str]]) -> None:
        self.there, self.acts = start, list(acts)
        self.looks: list[set[str]] = []
        self.said: list[str] = []
        self.clock = ManualClock()

    def look(self) -> set[str]:
        if self.looks:
            self.there = self.looks.pop(0)
        return set(self.there)

    def say(self, line: str) -> None:
        self.said.append(line)
        if self.acts:
            self.looks = self.acts.pop(0)

    def identify(self) -> tuple[str, str]:
        return by_unplugging(self.look, self.clock, self.say)


def test_the_camera_that_vanished_is_the_primary_and_the_other_the_assistant() -> None:
    hands = Hands({A, B}, [{A, B}, {A}], [{A}, {A, B}])
    assert hands.identify() == (B, A)
    assert len(hands.said) == 2 and B in hands.said[1]


def test_among_three_the_second_is_asked_for_too() -> None:
    hands = Hands({A, B, C}, [{A, B}], [{A, B, C}], [{B, C}], [{A, B, C}])
    assert hands.identify() == (C, A)


def test_a_plug_that_bounces_counts_once_it_rests() -> None:
    hands = Hands({A, B}, [{A}, {A, B}, {B}, {A, B}, {A}], [{A, B}])
    assert hands.identify() == (B, A)


@pytest.mark.parametrize("start", [set[str](), {A}])
def test_fewer_than_two_are_refused(start: set[str]) -> None:
    with pytest.raises(IdentifyError, match=rf"{len(start)} camera\(s\) found, two are needed"):
        Hands(start).identify()


def test_two_unplugged_together_are_refused() -> None:
    with pytest.raises(IdentifyError, match="vanished together"):
        Hands({A, B, C}, [{C}]).identify()


def test_the_primary_unplugged_again_is_refused() -> None:
    with pytest.raises(IdentifyError, match="is the primary already"):
        Hands({A, B, C}, [{B, C}], [{A, B, C}], [{B, C}]).identify()


def test_nothing_unplugged_ends_after_a_while() -> None:
    hands = Hands({A, B})
    with pytest.raises(IdentifyError, match="nothing happened in 300 s"):
        hands.identify()
    assert PATIENCE_NS <= hands.clock.now_ns() <= PATIENCE_NS + POLL_NS
