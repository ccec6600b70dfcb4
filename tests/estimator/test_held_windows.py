import dataclasses

import numpy as np
import pytest

from calm_edge.estimator.held_windows import HeldWindows, unsettled, worth_solving
from calm_edge.types import KitBelief, Prediction
from tests.drives import windows

UNKNOWN, RIG, KNOWN = np.array([0.5, 0.3]), np.array([0.01, 0.16]), np.array([0.005, 0.02])


@pytest.mark.parametrize(
    ("before", "now", "final", "worth"),
    [
        (UNKNOWN, RIG, False, True),
        (RIG, KNOWN, False, True),
        # a better guess that still does not guide the matching: only if no better one will come
        (UNKNOWN, np.array([0.03, 0.1]), False, False),
        (UNKNOWN, np.array([0.03, 0.1]), True, True),
        (UNKNOWN, UNKNOWN / 1.5, True, False),
        # what counts as known need not become better known
        (KNOWN, KNOWN / 4, True, False),
        (RIG, np.array([0.001, 0.16]), True, False),
    ],
)
def test_a_window_is_worth_solving_when_an_unknown_sigma_has_halved(before, now, final, worth):
    assert worth_solving(before, now, final=final) is worth


def test_a_window_is_settled_if_it_was_matched_with_a_known_rig_and_teaches_the_kit():
    kit = KitBelief(np.zeros(1), np.eye(1))
    taught = Prediction((), np.zeros((0, 4, 4)), kit=kit, kit_sigma=RIG)
    assert not unsettled(taught)
    assert unsettled(dataclasses.replace(taught, kit_sigma=UNKNOWN))
    assert unsettled(dataclasses.replace(taught, kit=None))
    # backbones without a kit, and recordings of earlier versions
    assert not unsettled(dataclasses.replace(taught, kit=None, kit_sigma=None))


def test_the_oldest_window_worth_it_comes_next_and_the_oldest_of_too_many_is_dropped():
    held, cut = HeldWindows(2), windows(60)
    for window in cut[:3]:
        held.hold(window, UNKNOWN)
    assert held.next(lambda _: RIG, final=False) is cut[1]
    held.hold(cut[1], RIG)
    assert held.next(lambda _: RIG, final=False) is cut[2]
    held.drop(2)
    held.drop(2)
    assert held.next(lambda _: RIG, final=True) is None
