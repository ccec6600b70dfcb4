"""Warps between pictures, on constructed matches."""

import numpy as np

from calm_edge.backbones.bundle import warp
from calm_edge.backbones.bundle.matching import Matches
from calm_edge.backbones.bundle.tracks import on_epipolar_lines

SIZE = (192, 640)
GRAY = np.zeros(SIZE, np.uint8)


def points(n, rng):
    return np.asarray(rng.uniform([20, 20], [620, 170], (n, 2)), np.float32)


def found(uv, sure):
    return Matches(np.asarray(uv, np.float32), sure, np.ones(len(uv), np.float32), sure)


def test_inliers_are_counted_and_other_sure_matches_are_not():
    rng = np.random.default_rng(0)
    uv = points(100, rng)
    H = warp.turned(GRAY, GRAY, 20.0, 0.5)
    there, inside = warp.seen_at(H, uv, GRAY)
    assert inside.all()
    sure = np.arange(100) < 60
    right = there + rng.normal(0, 1, there.shape)
    assert warp.agreeing(uv, found(right, sure), SIZE[1]) > 55
    # as many that are sure, at random places
    assert warp.agreeing(uv, found(points(100, rng), sure), SIZE[1]) < 25
    assert warp.agreeing(uv, found(right, np.arange(100) < 5), SIZE[1]) == 0


def test_the_homography_of_rotated_and_zoomed_matches_excludes_outliers():
    rng = np.random.default_rng(1)
    uv = points(120, rng)
    H = warp.turned(GRAY, GRAY, -12.0, 0.7)
    there, _ = warp.seen_at(H, uv, GRAY)
    there[:30] = points(30, rng)
    assert on_epipolar_lines(uv[30:], there[30:], 3.0).all()
    got = warp.homography(uv, found(there, np.ones(120, bool)), SIZE[1])
    again, _ = warp.seen_at(got, uv[30:], GRAY)
    assert np.abs(again - there[30:]).max() < 2
    assert abs(warp.zoom_of(got, GRAY) - 0.7) < 0.02
    assert warp.homography(uv, found(there, np.arange(120) < 8), SIZE[1]) is None


def test_small_rotations_and_zooms_need_no_warp():
    assert warp.are_alike(warp.turned(GRAY, GRAY, 3.0, 1.05), GRAY)
    assert not warp.are_alike(warp.turned(GRAY, GRAY, 6.0, 1.0), GRAY)
    assert not warp.are_alike(warp.turned(GRAY, GRAY, 0.0, 1.2), GRAY)


def test_points_outside_the_picture_are_marked():
    H = warp.turned(GRAY, GRAY, 0.0, 2.0)
    uv = np.array([[320.0, 96.0], [30.0, 96.0]], np.float32)
    there, inside = warp.seen_at(H, uv, GRAY)
    assert inside.tolist() == [True, False]
    assert np.allclose(there[0], [320.5, 96.5], atol=1)


def test_a_picture_is_smoothed_before_it_is_shrunk():
    fine = np.asarray(255 * (np.indices(SIZE).sum(0) % 2), np.uint8)
    shrunk = warp.warped(fine, warp.turned(fine, fine, 0.0, 2.0), fine)
    # a quarter of it is filled; aliasing would show as a pattern there
    assert shrunk[60:130, 200:440].std() < 0.2 * fine.std()
