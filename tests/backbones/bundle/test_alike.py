"""What makes pictures alike, on matches made by hand."""

import numpy as np

from calm_edge.backbones.bundle import alike
from calm_edge.backbones.bundle.matching import Found
from calm_edge.backbones.bundle.tracks import on_epipolar_lines

SIZE = (192, 640)
GRAY = np.zeros(SIZE, np.uint8)


def points(n, rng):
    return np.asarray(rng.uniform([20, 20], [620, 170], (n, 2)), np.float32)


def found(uv, sure):
    return Found(np.asarray(uv, np.float32), sure, np.ones(len(uv), np.float32), sure)


def test_what_agrees_is_told_from_what_is_only_sure():
    rng = np.random.default_rng(0)
    uv = points(100, rng)
    H = alike.turned(GRAY, GRAY, 20.0, 0.5)
    there, inside = alike.seen_at(H, uv, GRAY)
    assert inside.all()
    sure = np.arange(100) < 60
    right = there + rng.normal(0, 1, there.shape)
    assert alike.agreeing(uv, found(right, sure), SIZE[1]) > 55
    # as many that are sure, and each somewhere else
    assert alike.agreeing(uv, found(points(100, rng), sure), SIZE[1]) < 25
    assert alike.agreeing(uv, found(right, np.arange(100) < 5), SIZE[1]) == 0


def test_the_homography_of_turned_and_zoomed_matches_leaves_wrong_ones_out():
    rng = np.random.default_rng(1)
    uv = points(120, rng)
    H = alike.turned(GRAY, GRAY, -12.0, 0.7)
    there, _ = alike.seen_at(H, uv, GRAY)
    there[:30] = points(30, rng)
    assert on_epipolar_lines(uv[30:], there[30:], 3.0).all()
    got = alike.homography(uv, found(there, np.ones(120, bool)), SIZE[1])
    again, _ = alike.seen_at(got, uv[30:], GRAY)
    assert np.abs(again - there[30:]).max() < 2
    assert abs(alike.zoom_of(got, GRAY) - 0.7) < 0.02
    assert alike.homography(uv, found(there, np.arange(120) < 8), SIZE[1]) is None


def test_small_turns_and_zooms_are_left_as_they_are():
    assert alike.are_alike(alike.turned(GRAY, GRAY, 3.0, 1.05), GRAY)
    assert not alike.are_alike(alike.turned(GRAY, GRAY, 6.0, 1.0), GRAY)
    assert not alike.are_alike(alike.turned(GRAY, GRAY, 0.0, 1.2), GRAY)


def test_what_a_picture_does_not_show_is_said():
    H = alike.turned(GRAY, GRAY, 0.0, 2.0)
    uv = np.array([[320.0, 96.0], [30.0, 96.0]], np.float32)
    there, inside = alike.seen_at(H, uv, GRAY)
    assert inside.tolist() == [True, False]
    assert np.allclose(there[0], [320.5, 96.5], atol=1)


def test_a_shrunk_picture_is_smoothed_first():
    fine = np.asarray(255 * (np.indices(SIZE).sum(0) % 2), np.uint8)
    shrunk = alike.warped(fine, alike.turned(fine, fine, 0.0, 2.0), fine)
    # a quarter of it is filled; what aliases would be a pattern of its own there
    assert shrunk[60:130, 200:440].std() < 0.2 * fine.std()
