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
def test_turns_give_the_focal_within_few_percent_from_a_start_15_percent_long(kinds):
    _, found = searched(*kinds)
    assert error(found) < 0.015
    assert np.isfinite(found.log_sigma) and error(found) < 3 * found.log_sigma


@pytest.mark.parametrize(
    "kinds", [("straight",), ("tangent",), ("straight", "tangent", "-tangent", "straight")]
)
def test_straights_and_tangent_arcs_are_uninformative(kinds):
    assert searched(*kinds)[1].log_sigma == np.inf


def test_a_single_arc_does_not_separate_focal_and_principal_point():
    """With the axis 4 degrees off the tangent, 1 degree of the centre acts like 25 % of focal."""
    assert searched("ahead")[1].log_sigma > 0.05
    assert searched("ahead", off_px=12)[1].log_sigma > 0.05


def test_turns_in_both_directions_cancel_an_error_of_the_principal_point():
    _, one_way = searched("ahead", off_px=12)
    _, both_ways = searched("ahead", "-ahead", off_px=12)
    assert error(one_way) > 0.08
    assert error(both_ways) < 0.04 and error(both_ways) < 3 * both_ways.log_sigma


def test_twenty_percent_outliers_do_not_change_the_focal():
    _, found = searched("general", outliers=0.2)
    assert error(found) < 0.02 and np.isfinite(found.log_sigma)


def mean_score(bank, focals, weights=None):
    """Mean score (G,) of the bank at focals (G,) px."""
    scores = spectral.score_at(GUESS, focals, bank.F)
    return np.average(scores, -1, weights)


def test_without_weights_the_mean_score_is_minimised():
    bank, found = searched("general", "straight", weighted=False)
    focals = np.exp(found.log_focal + np.array([-0.02, 0, 0.02]))
    assert mean_score(bank, focals).argmin() == 1
    assert (found.weights == 1).all()


def test_with_weights_only_turns_contribute():
    bank, found = searched("general", "straight")
    assert found.weights[bank.group_of() == 1].sum() < 0.01 * found.weights.sum()


def test_the_score_of_a_turn_is_least_at_the_true_focal():
    bank, found = searched("general")
    focals = 700 * np.exp(np.linspace(-0.3, 0.3, 61))
    curve = mean_score(bank, focals, found.weights)
    assert curve.argmin() == pytest.approx(30, abs=1)
    assert curve[0] > 3 * curve.min() and curve[-1] > 3 * curve.min()


def test_disagreement_of_groups_increases_the_sigma():
    """Groups with focals of 700 and 770 px, turning in the same direction."""
    bank = TestBank(CorrectionConfig())
    bank.add(group("general", 0, guess=805.0), np.log(805))
    bank.add(group("general", 1, guess=805.0, focal=770.0), np.log(805))
    _, agreeing = searched("general", "general")
    assert agreeing.log_sigma < 0.1
    disagreeing = bank_focal.minimise(bank, GUESS, 805, weighted=True)
    assert disagreeing.log_sigma > 1.5 * agreeing.log_sigma
