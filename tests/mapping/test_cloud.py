import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calm_edge.geometry import se3
from calm_edge.mapping import cloud
from calm_edge.mapping.cloud import first_of_each, submap_points, voxel_keys
from tests.mapping import scene

STREET = scene.street(4)


@pytest.fixture(scope="module")
def piece():
    return scene.piece(STREET, 0, [0, 1, 2], scale=3.0)


def colors(piece):
    """Colours that encode the pixel: (view, row, column)."""
    index = np.indices(piece.depth.shape).astype(np.uint8)
    return np.moveaxis(index, 0, -1)


def points_of(piece, voxel=0.1, most=10**6, max_range=30.0, seed=0):
    return submap_points(
        piece.views(max_range), colors(piece), voxel, most, np.random.default_rng(seed)
    )


@given(
    st.lists(st.tuples(*[st.floats(-1000, 1000)] * 3), min_size=2, max_size=8), st.floats(0.05, 5)
)
def test_points_share_a_key_exactly_when_they_share_a_voxel(points, voxel):
    p = np.array(points)
    cell = np.floor(p / voxel)
    same = (cell[:, None] == cell).all(-1)
    keys = voxel_keys(p, voxel)
    np.testing.assert_array_equal(keys[:, None] == keys, same)


def test_points_lie_on_the_scene_one_per_voxel(piece):
    points, color = points_of(piece)
    p_w = se3.transform(piece.submap.T_w_s, points.astype(float))
    assert points.dtype == np.float32 and color.dtype == np.uint8
    assert scene.distance_to_scene(STREET, p_w).max() < 1e-3
    keys = voxel_keys(points, 0.1)
    assert len(np.unique(keys)) > 0.99 * len(keys)
    assert len(points) > 10_000


def test_every_voxel_a_pixel_falls_in_is_kept_with_its_nearest_pixel(piece):
    def depth_of(color):
        return piece.depth[tuple(color.astype(int).T)] * 3.0

    pixels, pixel_color = points_of(piece, voxel=1e-4)
    nearest: dict[int, float] = {}
    for key, z in zip(voxel_keys(pixels, 0.5).tolist(), depth_of(pixel_color), strict=True):
        nearest[key] = min(z, nearest.get(key, np.inf))
    points, color = points_of(piece, voxel=0.5)
    assert len(nearest) == pytest.approx(len(points), rel=0.01)
    depth = depth_of(color)
    expected = np.array([nearest.get(k, np.nan) for k in voxel_keys(points, 0.5).tolist()])
    # a point on a face may fall into the next voxel after rounding to float32
    # nearest up to the quantisation of depth in 65,535 steps
    assert (np.abs(expected - depth) <= depth.max() / 60_000).mean() > 0.99
    view = color[:, 0].astype(int)
    T = se3.inverse(piece.submap.T_s_c)[view]
    z = (T[:, 2, :3] * points).sum(-1) + T[:, 2, 3]
    np.testing.assert_allclose(z, depth, rtol=1e-4)


def test_far_unknown_and_unconfident_pixels_are_no_points(piece):
    depth, confidence = piece.depth.copy(), piece.confidence.copy()
    depth[:, :, :50] = 0
    confidence[:, :, 50:90] = 0.4
    cut = dataclasses.replace(piece, depth=depth, confidence=confidence)
    _, color = points_of(cut, max_range=12.0)
    view, y, x = color.astype(int).T
    assert x.min() >= 90
    assert (piece.depth[view, y, x] * 3.0).max() <= 12.0


def test_the_cap_takes_a_seeded_random_subset(piece):
    points, _ = points_of(piece)
    few, _ = points_of(piece, most=1000)
    assert len(few) == 1000
    np.testing.assert_array_equal(few, points_of(piece, most=1000)[0])
    assert not np.array_equal(few, points_of(piece, most=1000, seed=1)[0])
    assert set(map(tuple, few)) <= set(map(tuple, points))
    # from all views, not only the first ones
    assert abs(few[:, 2].mean() - points[:, 2].mean()) < 0.5


@given(st.integers(0, 10_000), st.integers(0, 400), st.integers(1, 300))
def test_the_first_of_each_key_is_found_by_hashing(seed, size, distinct):
    rng = np.random.default_rng(seed)
    values = rng.integers(0, 1 << 62, distinct)
    keys = values[rng.integers(0, distinct, size)] if size else np.empty(0, np.int64)
    expected = np.sort(np.unique(keys, return_index=True)[1])
    np.testing.assert_array_equal(np.sort(first_of_each(keys)), expected)


def test_keys_that_collide_in_every_round_are_separated_too(monkeypatch):
    monkeypatch.setattr(cloud, "MULTIPLIERS", (0, 0))
    keys = np.array([5, 9, 5, 7, 9, 3, 3, 7, 1])
    assert np.sort(first_of_each(keys)).tolist() == [0, 1, 3, 5, 8]
