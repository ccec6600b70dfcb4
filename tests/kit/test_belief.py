import numpy as np
import pytest

from calm_edge.kit.belief import product, sigmas
from calm_edge.types import KitBelief


def belief(mean, *rows):
    J = np.array(rows, float).reshape(-1, len(mean))
    return KitBelief(mean=np.array(mean, float), information=J.T @ J)


def test_product_skips_missing_beliefs():
    one = belief([1, 2], [1, 0])
    assert product([None, None]) is None
    assert product([None, one]) is one or np.array_equal(product([None, one]).mean, one.mean)
    assert np.array_equal(product([one, None]).information, one.information)


def test_informations_add_and_means_are_weighted():
    a, b = belief([0, 0], [2, 0], [0, 1]), belief([1, 4], [1, 1], [0, 3])
    both = product([a, b])
    assert np.allclose(both.information, a.information + b.information)
    expected = np.linalg.solve(both.information, a.information @ a.mean + b.information @ b.mean)
    assert np.allclose(both.mean, expected)


def test_singular_informations_combine():
    both = product([belief([3, 99], [1, 0]), belief([-99, 7], [0, 5])])
    assert np.allclose(both.mean, [3, 7])


def test_undetermined_directions_keep_the_first_mean():
    both = product([belief([3, 5, 8], [1, 0, 0]), belief([4, 0, 1], [1, 0, 0])])
    assert np.allclose(both.mean, [3.5, 5, 8])
    nothing = product([belief([3, 5], [0, 0]), belief([1, 1], [0, 0])])
    assert np.array_equal(nothing.mean, [3, 5])


def test_units_ten_decades_apart_are_solved():
    a = belief([1, 0], [1e-5, 0], [0, 1e5])
    b = belief([3, 2], [1e-5, 0], [0, 1e5])
    assert np.allclose(product([a, b]).mean, [2, 1])


def test_the_product_is_commutative_if_the_sum_has_full_rank():
    rng = np.random.default_rng(3)
    beliefs = [belief(rng.normal(size=4), *rng.normal(size=(2, 4))) for _ in range(5)]
    together = product(beliefs)
    one_by_one = None
    for each in reversed(beliefs):
        one_by_one = product([one_by_one, each])
    assert np.allclose(together.mean, one_by_one.mean)
    assert np.allclose(together.information, one_by_one.information)


def test_beliefs_of_different_sizes_raise():
    with pytest.raises(ValueError, match="number of entries"):
        product([belief([1, 2], [1, 0]), belief([1], [1])])


def test_sigmas_are_in_the_units_of_the_entries():
    assert np.allclose(sigmas(belief([5, 7, 9], [4, 0, 0], [0, 0.5, 0])), [0.25, 2, 0])
