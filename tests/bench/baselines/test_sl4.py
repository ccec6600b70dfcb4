"""Homography of an overlap, exact and with outliers, and the cameras decomposed from it."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.baselines import sl4
from bench.baselines.overlap import BaselineError, Correspondences
from calm_edge.geometry import se3
from tests.bench.baselines.chains import drive, moved, points
from tests.drives import curved

SUBMAPS = drive(curved(30)).submaps[:2]


def homography(seed: int, bend: float = 0.005) -> np.ndarray:
    """(4, 4) det 1: an affine map near a similarity, and a plane at infinity behind the points."""
    rng = np.random.default_rng(seed)
    H = se3.exp(rng.normal(size=6)) @ np.diag([*np.exp(rng.normal(0, 0.3, 3)), 1.0])
    H[:3, :3] += rng.normal(0, 0.05, (3, 3))
    H[3, :3] = bend * rng.uniform(-1, 1, 3)
    return H / np.linalg.det(H) ** 0.25


def matches(H: np.ndarray, n: int = 200) -> Correspondences:
    p = points(n)
    return Correspondences(moved(H, p), p, np.ones(n))


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([6, 30, 1500]))
def test_a_homography_is_recovered(seed: int, n: int) -> None:
    H = homography(seed)
    found = sl4.place(*SUBMAPS, matches(H, n))
    assert np.linalg.det(found) == pytest.approx(1)
    assert np.allclose(moved(found, points(40, seed=1)), moved(H, points(40, seed=1)), atol=1e-5)
    # points in front of all cameras stay on the near side of infinity
    assert (np.column_stack([points(40), np.ones(40)]) @ found[3] > 0).all()


def test_five_points_are_enough() -> None:
    H, some = homography(3), matches(homography(3), 5)
    assert np.allclose(sl4.place(*SUBMAPS, some), H, atol=1e-8)


def test_thirty_percent_outliers_do_not_move_it() -> None:
    H, rng = homography(7), np.random.default_rng(5)
    some = matches(H)
    some.previous[rng.permutation(200)[:60]] += rng.uniform(2, 10, (60, 3))
    assert np.allclose(sl4.place(*SUBMAPS, some), H, atol=1e-7)


def test_the_same_points_give_the_same_bits() -> None:
    rng = np.random.default_rng(1)
    some = matches(homography(4))
    noisy = Correspondences(some.previous + rng.normal(0, 0.05, (200, 3)), some.new, some.weight)
    assert np.array_equal(sl4.place(*SUBMAPS, noisy), sl4.place(*SUBMAPS, noisy))


def of(previous: np.ndarray, new: np.ndarray) -> Correspondences:
    return Correspondences(previous, new, np.ones(len(new)))


def plane(noise: float = 0.0) -> Correspondences:
    p = points(100) * [1, 0, 1] + [0, 1.65, 0]
    rng = np.random.default_rng(0)
    return of(p + noise * rng.normal(size=p.shape), p + noise * rng.normal(size=p.shape))


@pytest.mark.parametrize(
    ("some", "reason"),
    [
        (of(points(0), points(0)), "0 common points"),
        (of(points(4), points(4)), "4 common points"),
        (of(np.full((9, 3), np.nan), points(9)), "0 common points"),
        (of(np.ones((9, 3)), np.ones((9, 3))), "coincide"),
        (of(points(100) * [1, 1, -1], points(100)), "mirrored"),
        (plane(), "planar"),
    ],
)
def test_too_little_is_a_reason(some: Correspondences, reason: str) -> None:
    with pytest.raises(BaselineError, match=reason):
        sl4.place(*SUBMAPS, some)


def test_points_that_share_nothing_agree_on_nothing() -> None:
    rng = np.random.default_rng(0)
    some = of(rng.normal(size=(60, 3)) * 1e3, rng.normal(size=(60, 3)))
    try:
        H = sl4.place(*SUBMAPS, some)
    except BaselineError as error:
        assert str(error)
    else:
        assert np.isfinite(H).all() and np.linalg.det(H) == pytest.approx(1)


def test_an_almost_flat_overlap_fails_or_stays_a_homography() -> None:
    try:
        H = sl4.place(*SUBMAPS, plane(noise=1e-3))
    except BaselineError as error:
        assert str(error)
    else:
        assert np.isfinite(H).all() and np.linalg.det(H) == pytest.approx(1)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000))
def test_cameras_project_the_moved_points_where_they_saw_them(seed: int) -> None:
    H, submap = homography(seed, bend=0.002), SUBMAPS[1]
    T_w_c = sl4.poses(H, submap)
    R = T_w_c[:, :3, :3]
    assert np.allclose(R @ np.swapaxes(R, 1, 2), np.eye(3), atol=1e-9)
    assert np.linalg.det(R) == pytest.approx(np.ones(len(R)))
    # the centre moves like any point
    centres = submap.T_s_c_raw[:, :3, 3]
    assert np.allclose(T_w_c[:, :3, 3], moved(H, centres), atol=1e-7)
    # and some calibration projects to the same pixels
    p_s = se3.transform(submap.T_s_c_raw[3], points(50))
    uv = submap.cameras_raw[3].project(points(50))
    p_c = se3.transform(se3.inverse(T_w_c[3]), moved(H, p_s))
    homogeneous = np.column_stack([uv, np.ones(50)])
    K_left, *_ = np.linalg.lstsq(p_c / p_c[:, 2:], homogeneous, rcond=None)
    assert np.allclose((p_c / p_c[:, 2:]) @ K_left, homogeneous, atol=1e-5)


def test_a_broken_homography_has_no_cameras() -> None:
    for H in (np.full((4, 4), np.nan), np.zeros((4, 4))):
        with pytest.raises(BaselineError, match="projection matrix"):
            sl4.poses(H, SUBMAPS[0])
