"""Similarity of an overlap, exact and with outliers."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.baselines import sim3
from bench.baselines.overlap import BaselineError, Correspondences
from calm_edge.geometry import se3
from calm_edge.geometry.similarity import Similarity, align
from tests.bench.baselines.chains import drive, points
from tests.drives import curved

THREE = st.lists(st.floats(-3, 3), min_size=3, max_size=3)
SUBMAPS = drive(curved(30)).submaps[:2]


def matches(true: Similarity, n: int = 300, weight: np.ndarray | None = None) -> Correspondences:
    p = points(n)
    return Correspondences(true.points(p), p, np.ones(n) if weight is None else weight)


@settings(max_examples=25, deadline=None)
@given(st.floats(0.05, 20), THREE, THREE)
def test_a_similarity_is_recovered(scale: float, w: list[float], t: list[float]) -> None:
    true = Similarity(scale, se3.so3_exp(np.array(w)), 10 * np.array(t))
    assert np.allclose(sim3.place(*SUBMAPS, matches(true)), true.matrix(), atol=1e-8 * (1 + scale))


def with_outliers(true: Similarity, share: float) -> Correspondences:
    exact, rng = matches(true), np.random.default_rng(5)
    wrong = rng.permutation(300)[: int(300 * share)]
    previous = exact.previous.copy()
    previous[wrong] += rng.uniform(0, 10, (len(wrong), 3))
    return Correspondences(previous, exact.new, exact.weight)


def test_thirty_percent_outliers_hardly_move_it() -> None:
    true = Similarity(1.7, se3.so3_exp(np.array([0.1, 0.4, -0.2])), np.array([1.0, 2.0, 3.0]))
    some = with_outliers(true, 0.3)
    found = Similarity.from_matrix(sim3.place(*SUBMAPS, some))
    plain = align(some.new, some.previous, with_scale=True)
    p, unit = points(50, seed=9), some.unit()
    assert np.linalg.norm(found.points(p) - true.points(p), axis=1).max() < 0.005 * unit
    assert np.linalg.norm(plain.points(p) - true.points(p), axis=1).max() > 0.05 * unit


def test_the_scale_does_not_shrink_with_noise() -> None:
    rng, true = np.random.default_rng(2), Similarity(1.0, np.eye(3), np.zeros(3))
    exact = matches(true, 4000)
    noisy = Correspondences(
        exact.previous + rng.normal(0, 2, (4000, 3)),
        exact.new + rng.normal(0, 2, (4000, 3)),
        exact.weight,
    )
    scale = Similarity.from_matrix(sim3.place(*SUBMAPS, noisy)).scale
    assert scale == pytest.approx(1, abs=0.01)
    assert align(noisy.new, noisy.previous, with_scale=True).scale < 0.97


def test_distrusted_points_count_less() -> None:
    weight = np.where(np.arange(300) < 150, 1.0, 1e-9)
    true = Similarity(2.0, np.eye(3), np.ones(3))
    exact = matches(true, weight=weight)
    previous = exact.previous.copy()
    previous[150:] += [0.3, 0.0, 0.0]
    found = sim3.place(*SUBMAPS, Correspondences(previous, exact.new, weight))
    assert np.allclose(found, true.matrix(), atol=1e-6)


def bad(n: int, p: np.ndarray | None = None) -> Correspondences:
    p = points(n) if p is None else p
    return Correspondences(p, p, np.ones(len(p)))


@pytest.mark.parametrize(
    ("some", "reason"),
    [
        (bad(0), "0 common points"),
        (bad(2), "2 common points"),
        (bad(9, np.full((9, 3), np.nan)), "0 common points"),
        (bad(9, np.ones((9, 3))), "line"),
        (bad(9, np.outer(np.arange(9.0), [1, 2, 3])), "line"),
    ],
)
def test_too_little_is_a_reason(some: Correspondences, reason: str) -> None:
    with pytest.raises(BaselineError, match=reason):
        sim3.place(*SUBMAPS, some)


def test_numbers_that_are_none_are_left_out() -> None:
    true = Similarity(0.5, np.eye(3), np.ones(3))
    exact = matches(true)
    previous = exact.previous.copy()
    previous[::3, 1] = np.nan
    previous[1::3, 0] = np.inf
    found = sim3.place(*SUBMAPS, Correspondences(previous, exact.new, exact.weight))
    assert np.allclose(found, true.matrix(), atol=1e-9)


def test_a_broken_transform_has_no_poses() -> None:
    with pytest.raises(BaselineError, match="similarity"):
        sim3.poses(np.full((4, 4), np.nan), SUBMAPS[0])
