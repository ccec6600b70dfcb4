"""Known similarities are estimated, with and without weights."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calm_edge.geometry import se3
from calm_edge.geometry.similarity import Similarity, align

THREE = st.lists(st.floats(-3, 3), min_size=3, max_size=3)


def similarity(scale: float, w: list[float], t: list[float]) -> Similarity:
    return Similarity(scale, se3.so3_exp(np.array(w)), 30 * np.array(t))


def cloud(n: int = 60, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(n, 3)) * [20.0, 3.0, 40.0]


@settings(max_examples=25, deadline=None)
@given(st.floats(0.05, 20), THREE, THREE)
def test_a_similarity_is_estimated_and_inverted(
    scale: float, w: list[float], t: list[float]
) -> None:
    true, p = similarity(scale, w, t), cloud()
    found = align(p, true.points(p), with_scale=True)
    assert found.scale == pytest.approx(scale, rel=1e-9)
    T = se3.exp(np.random.default_rng(1).normal(size=(5, 6)))
    assert np.allclose(found.poses(T), true.poses(T), atol=1e-6)
    assert np.allclose(found.inverse().poses(found.poses(T)), T, atol=1e-6)


@settings(max_examples=25, deadline=None)
@given(st.floats(0.05, 20), THREE, THREE)
def test_the_matrix_is_the_same_transform(scale: float, w: list[float], t: list[float]) -> None:
    true, p = similarity(scale, w, t), cloud(5)
    assert np.allclose(se3.transform(true.matrix(), p), true.points(p), atol=1e-9)
    back = Similarity.from_matrix(true.matrix())
    assert np.allclose(back.points(p), true.points(p), atol=1e-8)
    assert np.allclose(back.R @ back.R.T, np.eye(3), atol=1e-9)


def test_alignment_never_mirrors() -> None:
    p = np.random.default_rng(0).normal(size=(30, 3))
    found = align(p * [1, 1, -1], p, with_scale=True)
    assert np.linalg.det(found.R) == pytest.approx(1)


def test_a_weight_is_equivalent_to_repeated_points() -> None:
    p, rng = cloud(20), np.random.default_rng(3)
    q = p + rng.normal(size=p.shape)
    times = rng.integers(0, 4, len(p))
    weighted = align(p, q, with_scale=True, weights=times.astype(float))
    repeated = align(np.repeat(p, times, 0), np.repeat(q, times, 0), with_scale=True)
    assert np.allclose(weighted.matrix(), repeated.matrix(), atol=1e-9)
    assert not np.allclose(weighted.matrix(), align(p, q, True).matrix(), atol=1e-3)
