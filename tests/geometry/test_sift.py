from __future__ import annotations

import cv2
import numpy as np
import pytest

from calm_edge.geometry import sift
from calm_edge.geometry.sift import Features

SHIFT = np.array([7.0, 3.0])


def blobs(seed=0, size=(320, 160), n=150):
    """A grey image of blurred spots."""
    rng = np.random.default_rng(seed)
    picture = np.full(size[::-1], 120, np.float32)
    for _ in range(n):
        centre = tuple(int(v) for v in rng.integers(0, size))
        cv2.circle(picture, centre, int(rng.integers(2, 9)), float(rng.integers(0, 255)), -1)
    return cv2.GaussianBlur(picture, (0, 0), 1.0).astype(np.uint8)


def test_features_of_a_shifted_image_match_with_that_shift():
    big = blobs(size=(360, 200))
    a = sift.detect(big[10:170, 10:330], 300)
    b = sift.detect(big[13:173, 17:337], 300)
    pairs = sift.match(a, b)
    moved = a.uv[pairs[:, 0]] - b.uv[pairs[:, 1]]
    assert len(pairs) > 80
    assert np.median(np.abs(moved - SHIFT)) < 0.05
    assert len(np.unique(pairs[:, 0])) == len(np.unique(pairs[:, 1])) == len(pairs)


def test_positions_are_those_of_the_full_picture():
    """A wide image is reduced; features of its mirror image reveal an offset."""
    wide = cv2.resize(blobs(), (4 * 320, 4 * 160), interpolation=cv2.INTER_CUBIC)
    a = sift.detect(wide, 200).uv
    b = sift.detect(np.ascontiguousarray(wide[:, ::-1]), 200).uv
    b[:, 0] = wide.shape[1] - 1 - b[:, 0]
    nearest = np.linalg.norm(a[:, None] - b[None], axis=2).argmin(1)
    off = a[:, 0] - b[nearest, 0]
    assert abs(np.median(off[np.abs(off) < 3])) < 0.1
    assert a[:, 0].max() > 1000


def test_descriptors_have_unit_length_and_no_point_is_repeated():
    found = sift.detect(blobs(), 100)
    assert np.linalg.norm(found.vector, axis=1) == pytest.approx(np.ones(len(found.uv)), abs=1e-4)
    assert len(np.unique(found.uv, axis=0)) == len(found.uv) > 25
    assert found.uv.dtype == found.vector.dtype == np.float32


def test_a_blank_image_has_no_features_and_no_matches():
    blank = sift.detect(np.full((60, 80), 90, np.uint8), 100)
    assert blank.uv.shape == (0, 2) and blank.vector.shape == (0, 128)
    assert sift.match(blank, sift.detect(blobs(), 100)).shape == (0, 2)
    assert sift.consistent(blank, blank, 1.0).shape == (0, 2)


def test_an_ambiguous_match_is_rejected():
    vector = np.eye(3, 128, dtype=np.float32)
    a = Features(np.zeros((3, 2), np.float32), vector)
    twice = Features(np.zeros((4, 2), np.float32), vector[[0, 0, 1, 2]])
    assert sift.match(a, twice).tolist() == [[1, 2], [2, 3]]


def test_outliers_of_the_fundamental_matrix_are_removed():
    rng = np.random.default_rng(1)
    uv = rng.uniform(0, 300, (60, 2)).astype(np.float32)
    vector = np.eye(60, 128, dtype=np.float32)
    moved = uv + np.c_[rng.uniform(5, 40, 60), np.zeros(60)].astype(np.float32)
    moved[:15, 1] += rng.uniform(10, 60, 15).astype(np.float32)
    kept = sift.consistent(Features(uv, vector), Features(moved, vector), 1.0)
    assert set(range(15, 60)) <= set(kept[:, 0]) and (kept[:, 0] < 15).sum() <= 2


@pytest.mark.parametrize(
    ("columns", "rows", "spread"), [(8, 4, True), (2, 4, False), (5, 1, False), (3, 2, True)]
)
def test_spread_counts_cells_and_columns(columns, rows, spread):
    size = np.array([320, 160])
    u, v = np.meshgrid(40 * np.arange(columns) + 20, 40 * np.arange(rows) + 20)
    assert sift.well_spread(np.stack([u, v], -1).reshape(-1, 2), size) == spread


@pytest.mark.parametrize(("gain", "offset"), [(0.4, 0.0), (0.15, 10.0), (0.1, 200.0)])
def test_a_dark_picture_has_the_features_of_a_bright_one(gain, offset):
    bright = blobs()
    dark = np.clip(gain * bright + offset, 0, 255).astype(np.uint8)
    a, b = sift.detect(bright, 200), sift.detect(dark, 200)
    pairs = sift.match(a, b)
    near = np.linalg.norm(a.uv[pairs[:, 0]] - b.uv[pairs[:, 1]], axis=1) < 0.5
    assert near.sum() > 0.5 * len(a.uv)


def test_an_upright_picture_is_reduced_like_a_lying_one():
    wide = cv2.resize(blobs(), (4 * 320, 4 * 160), interpolation=cv2.INTER_CUBIC)
    a = sift.detect(wide, 200).uv
    b = sift.detect(np.ascontiguousarray(wide.T), 200).uv[:, ::-1]
    nearest = np.linalg.norm(a[:, None] - b[None], axis=2).min(1)
    assert (nearest < 0.5).mean() > 0.8
