import numpy as np
import pytest

from bench.scripted.motions import CAMERA, group
from calm_edge.config import CorrectionConfig
from calm_edge.correction import bank_focal, spectral
from calm_edge.correction.test_bank import TestBank

GUESS = CAMERA.with_focal(805.0)


def searched(*kinds, weighted=True, outliers=0.0, off_px=0.0):
    bank = TestBank(CorrectionConfig())
    for seed, kind in enumerate(kinds):
        made = group(kind, seed, guess=805.0, outliers=outliers, off_px=(off_px, 0.0))
        bank.add(made, np.log(805))
    return bank, bank_focal.minimise(bank, GUESS, 805, weighted=weighted)


def error(found):
    return abs(found.log_focal - np.log(700))


@pytest.mark.parametrize(
    "kinds", [("general",), ("yawed",), ("ahead", "-ahead"), ("straight", "general", "tangent")]
)
def test_turns_tell_the_focal_within_few_percent_of_a_guess_15_percent_long(kinds):
    _, found = searched(*kinds)
    assert error(found) < 0.015
    assert np.isfinite(found.log_sigma) and error(found) < 3 * found.log_sigma


@pytest.mark.parametrize(
    "kinds", [("straight",), ("tangent",), ("straight", "tangent", "-tangent", "straight")]
)
def test_straights_and_tangent_arcs_are_uninformative(kinds):
    assert searched(*kinds)[1].log_sigma == np.inf


def test_one_arc_ahead_of_the_axle_cannot_rule_the_principal_point_out():
    """One degree aside of an axis four degrees off the tangent: a quarter of the focal."""
    assert searched("ahead")[1].log_sigma > 0.05
    assert searched("ahead", off_px=12)[1].log_sigma > 0.05


def test_turning_both_ways_cancels_a_principal_point_off_centre():
    _, one_way = searched("ahead", off_px=12)
    _, both_ways = searched("ahead", "-ahead", off_px=12)
    assert error(one_way) > 0.08
    assert error(both_ways) < 0.04 and error(both_ways) < 3 * both_ways.log_sigma


def test_a_fifth_of_wrong_matches_does_not_move_the_focal():
    _, found = searched("general", outliers=0.2)
    assert error(found) < 0.02 and np.isfinite(found.log_sigma)


def mean_score(bank, focals, weights=None):
    """The bank's mean score (G,) at focals (G,) px."""
    scores = spectral.score_at(GUESS, focals, bank.F)
    return np.average(scores, -1, weights)


def test_plainly_it_is_the_mean_score_that_is_minimised():
    bank, found = searched("general", "straight", weighted=False)
    focals = np.exp(found.log_focal + np.array([-0.02, 0, 0.02]))
    assert mean_score(bank, focals).argmin() == 1
    assert (found.weights == 1).all()


def test_weighted_only_the_turn_counts():
    bank, found = searched("general", "straight")
    assert found.weights[bank.group_of() == 1].sum() < 0.01 * found.weights.sum()


def test_the_curve_of_a_turn_has_its_valley_at_the_truth():
    bank, found = searched("general")
    focals = 700 * np.exp(np.linspace(-0.3, 0.3, 61))
    curve = mean_score(bank, focals, found.weights)
    assert curve.argmin() == pytest.approx(30, abs=1)
    assert curve[0] > 3 * curve.min() and curve[-1] > 3 * curve.min()


def test_groups_that_disagree_widen_the_sigma():
    """A bank over which the lens was zoomed from 700 to 770 px, turning the same way."""
    bank = TestBank(CorrectionConfig())
    bank.add(group("general", 0, guess=805.0), np.log(805))
    bank.add(group("general", 1, guess=805.0, focal=770.0), np.log(805))
    _, agreeing = searched("general", "general")
    assert agreeing.log_sigma < 0.1
    disagreeing = bank_focal.minimise(bank, GUESS, 805, weighted=True)
    assert disagreeing.log_sigma > 1.5 * agreeing.log_sigma
