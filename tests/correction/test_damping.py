from dataclasses import replace

import numpy as np
import pytest

from calm_edge.config import CorrectionConfig
from calm_edge.correction import damping

CONFIG = CorrectionConfig()


@pytest.mark.parametrize(
    ("n_matrices", "expected"), [(0, 0), (49, 0), (50, 0.1), (105, 0.2), (499, 0.9), (500, 1)]
)
def test_full_damping_takes_five_hundred_matrices(n_matrices, expected):
    assert damping.from_density(n_matrices, CONFIG) == pytest.approx(expected)


def test_a_bank_of_all_pairs_is_full_and_never_more():
    assert damping.from_density(525, CONFIG) == damping.from_density(9999, CONFIG) == 1
    assert damping.from_density(525, replace(CONFIG, n_feature=20)) == pytest.approx(0.5)


def test_a_search_surer_than_the_guesses_corrects_them_and_the_other_way_round():
    guesses = np.log(700) + 0.05 * np.array([-1, 1, 1, -1])
    assert damping.from_uncertainty(guesses, np.log(700), 0.005, 0.0) == 1
    assert damping.from_uncertainty(guesses, np.log(700), 0.03, 0.0) == pytest.approx(0.6)
    assert damping.from_uncertainty(guesses, np.log(700), 0.08, 0.0) == 0


def test_uninformed_or_without_guesses_nothing_is_corrected():
    assert damping.from_uncertainty(np.log([700.0]), np.log(800), np.inf, 1.0) == 0
    assert damping.from_uncertainty(np.zeros(0), np.log(800), 0.01, 0.0) == 0


def test_a_step_is_held_until_clearly_left():
    guesses = np.log(700) + 0.05 * np.array([-1, 1])

    def wanting(wanted, held):
        sigma = 0.05 * np.sqrt(1 - wanted)
        return damping.from_uncertainty(guesses, np.log(700), sigma, held)

    assert wanting(0.56, 0.6) == 0.6 and wanting(0.74, 0.6) == 0.6
    assert wanting(0.54, 0.6) == pytest.approx(0.5) and wanting(0.76, 0.6) == pytest.approx(0.7)


def test_it_leaves_the_least_error():
    """Over many drives: no other tenth does much better than the one chosen, rounded down."""
    rng = np.random.default_rng(0)
    own, sigma, left = 0.06, 0.04, np.zeros(11)
    for _ in range(2000):
        guesses, global_error = rng.normal(size=40) * own, rng.normal() * sigma
        for n, d in enumerate(np.arange(11) / 10):
            left[n] += np.mean(((1 - d) * guesses + d * global_error) ** 2)
    guesses = rng.normal(size=5000) * own - rng.normal(size=5000) * sigma
    chosen = damping.from_uncertainty(guesses, 0.0, sigma, 0.0)
    assert left[round(chosen * 10)] < 1.05 * left.min()
