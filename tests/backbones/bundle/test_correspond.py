"""Matching by synthetic features: one picture is the other, shifted."""

import numpy as np
import pytest

from calm_edge.backbones.bundle import correspond
from calm_edge.backbones.bundle.features import Features
from calm_edge.backbones.onnx.picture_input import Fit

CELLS = (12, 20)
INPUT = (160, 96)


class Refiner:
    """Refines nothing, and claims a sigma of one input pixel."""

    def refined(self, there, here):
        assert there.shape == here.shape == (len(there), 81)
        return np.zeros((len(there), 2), np.float32), np.ones(len(there), np.float32)


def features(coarse, reliability=None, zoom=2.0):
    """Of a picture that is `zoom` times the size of the input."""
    picture = (int(INPUT[0] * zoom), int(INPUT[1] * zoom))
    if reliability is None:
        reliability = np.ones(CELLS, np.float32)
    fine = np.ones((24, 40, 32), np.float32)
    return Features(Fit(picture, INPUT, (0, 0), INPUT), coarse, reliability, fine, np.zeros(256))


@pytest.fixture
def coarse():
    """(h, w, 64) random directions, each cell a bit like its neighbours."""
    cells = np.random.default_rng(0).normal(size=(*CELLS, 64))
    cells += 0.5 * (np.roll(cells, 1, 1) + np.roll(cells, 1, 0))
    return (cells / np.linalg.norm(cells, axis=2, keepdims=True)).astype(np.float32)


def centres(x, y):
    """Picture pixels of the middles of cells x, y, at twice the input's size."""
    return np.stack([16 * (np.asarray(x) + 0.5) - 0.5, 16 * (np.asarray(y) + 0.5) - 0.5], 1)


def test_moved_cells_are_matched(coarse):
    a, b = features(coarse), features(np.roll(coarse, (2, 3), (0, 1)))
    uv = centres([4, 5, 9, 12], [3, 6, 2, 8]).astype(np.float32)
    found = correspond.find(Refiner(), a, b, uv)
    assert found.sure.all()
    np.testing.assert_allclose(found.uv - uv, [[48, 32]] * len(uv), atol=4)
    np.testing.assert_allclose(found.sigma_px, 2)


def test_a_point_between_cells_is_interpolated(coarse):
    a = features(coarse)
    uv = np.array([[16 * 6.0 - 0.5, 16 * 4.5 - 0.5]], np.float32)
    found = correspond.find(Refiner(), a, a, uv)
    assert abs(found.uv[0, 0] - uv[0, 0]) < 5


def test_a_point_that_left_the_picture_is_not_sure(coarse):
    gone = coarse.copy()
    gone[:, :10] = np.random.default_rng(1).normal(size=(CELLS[0], 10, 64))
    gone /= np.linalg.norm(gone, axis=2, keepdims=True)
    uv = centres(np.arange(1, 9), [5] * 8).astype(np.float32)
    assert correspond.find(Refiner(), features(coarse), features(gone), uv).sure.mean() < 0.3
    stayed = centres(np.arange(11, 18), [5] * 7).astype(np.float32)
    assert correspond.find(Refiner(), features(coarse), features(gone), stayed).sure.all()


def test_a_point_of_low_reliability_is_not_sure(coarse):
    reliability = np.ones(CELLS, np.float32)
    reliability[:, 10:] = 0.01
    uv = centres([4, 15], [5, 5]).astype(np.float32)
    a = features(coarse, reliability)
    assert correspond.find(Refiner(), a, a, uv).sure.tolist() == [True, False]


def test_a_corner_of_a_pattern_that_repeats_is_not_sure(coarse):
    fence = coarse.copy()
    fence[:, 14:18] = fence[:, 4:8]
    a = features(coarse)
    uv = centres([5, 6, 1, 10], [5, 7, 5, 7]).astype(np.float32)
    found = [
        correspond.find(Refiner(), a, features(fence), uv, corner).sure.tolist()
        for corner in (None, np.ones(4, bool), np.array([False, True, True, True]))
    ]
    assert found == [[True] * 4, [False, False, True, True], [True, False, True, True]]


def test_matches_are_in_the_pixels_of_pictures_of_different_size(coarse):
    uv = centres([4, 9], [3, 6]).astype(np.float32)
    found = correspond.find(Refiner(), features(coarse), features(coarse, zoom=4.0), uv)
    np.testing.assert_allclose(found.uv, 2 * (uv + 0.5) - 0.5, atol=5)
    np.testing.assert_allclose(found.sigma_px, 4)


def test_no_queries_no_matches(coarse):
    none = np.zeros((0, 2), np.float32)
    found = correspond.find(Refiner(), features(coarse), features(coarse), none)
    assert len(found.uv) == len(found.sure) == len(found.sigma_px) == 0


def test_correlations_interpolate_the_map():
    random = np.random.default_rng(2)
    fine = random.normal(size=(24, 40, 8)).astype(np.float32)
    query = random.normal(size=(3, 8)).astype(np.float32)
    uv = np.array([[80.3, 41.9], [60.0, 50.0], [1.0, 2.0]], np.float32)
    found = correspond.correlations(fine, uv, query)
    # column k of a row lies k - 4 fine cells right of the guess
    for point, k in ((0, 40), (0, 3), (1, 77)):
        step = np.array([k % 9 - 4, k // 9 - 4]) * 4
        unscaled = bilinear(fine, (uv[point] + step + 0.5) / 4 - 0.5)
        np.testing.assert_allclose(found[point, k], unscaled @ query[point], rtol=1e-4, atol=1e-4)
    assert np.isfinite(found[2]).all()


def bilinear(maps, at):
    """Map (h, w, C) at x, y in cells."""
    x, y = np.floor(at).astype(int)
    fx, fy = at - (x, y)
    top = maps[y, x] * (1 - fx) + maps[y, x + 1] * fx
    return top * (1 - fy) + (maps[y + 1, x] * (1 - fx) + maps[y + 1, x + 1] * fx) * fy
