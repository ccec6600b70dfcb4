from dataclasses import replace

import pytest

from calm_edge.config import CorrectionConfig
from calm_edge.correction import damping

CONFIG = CorrectionConfig()


@pytest.mark.parametrize(
    ("n_matrices", "expected"), [(0, 0), (49, 0), (50, 0.1), (105, 0.2), (499, 0.9), (500, 1)]
)
def test_full_damping_takes_five_hundred_matrices(n_matrices, expected):
    assert damping.from_density(n_matrices, CONFIG) == pytest.approx(expected)


def test_damping_is_at_most_one():
    assert damping.from_density(525, CONFIG) == damping.from_density(9999, CONFIG) == 1
    assert damping.from_density(525, replace(CONFIG, n_feature=20)) == pytest.approx(0.5)


@pytest.mark.parametrize(("n", "expected"), [(1, 0), (2, 0.5), (5, 0.8), (19, 0.9), (21, 1.0)])
def test_damping_grows_with_the_number_of_guesses(n, expected):
    assert damping.from_guesses(n) == expected
