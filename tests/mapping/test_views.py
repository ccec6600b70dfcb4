import dataclasses

import numpy as np
import pytest

from calm_edge.mapping.views import MappingError, Sightings, confirmed, lift, prepare, sample, sight
from tests.mapping import scene

STREET = scene.street(1)


@pytest.fixture(scope="module")
def piece():
    return scene.piece(STREET, 0, [0, 1, 2], scale=2.5)


def everywhere(views, step=7):
    v, y, x = np.meshgrid(
        np.arange(len(views.cameras)),
        np.arange(0, 96, step),
        np.arange(0, 160, step),
        indexing="ij",
    )
    return v.ravel(), np.stack([x.ravel(), y.ravel()], -1)


def test_lifted_pixels_lie_on_the_scene_in_world_units(piece):
    views = piece.views(max_range=100.0)
    view, xy = everywhere(views)
    uv = views.to_image(view, xy)
    p_s = lift(views, view, uv, sample(views, view, uv))
    p_w = p_s @ piece.submap.T_w_s[:3, :3].T + piece.submap.T_w_s[:3, 3]
    assert scene.distance_to_scene(STREET, p_w).max() < 1e-3


def test_image_and_map_pixels_convert_as_resized_cameras_do(piece):
    views = piece.views()
    p_c = np.array([0.4, -0.2, 3.0])
    small = views.cameras[0].scaled(*views.map_per_image[0])
    xy = views.to_map(np.array(0), views.cameras[0].project(p_c))
    np.testing.assert_allclose(xy, small.project(p_c))
    np.testing.assert_allclose(views.to_image(np.array(0), xy), views.cameras[0].project(p_c))


def test_sampling_between_pixels_is_exact_on_a_plane():
    ground = scene.Scene(
        np.array([[0.0, 1, 0], [0, 0, 1]]), np.array([1.5, 60]), np.empty((0, 3)), np.empty(0)
    )
    views = scene.piece(ground, 0, [0]).views()
    uv = np.random.default_rng(0).uniform([0, 130], [319, 190], (200, 2))
    view = np.zeros(200, int)
    p_s = lift(views, view, uv, sample(views, view, uv))
    np.testing.assert_allclose(p_s[:, 1], 1.5, rtol=1e-5)


def test_unknown_unconfident_far_and_outside_pixels_sample_to_zero(piece):
    depth, confidence = piece.depth.copy(), piece.confidence.copy()
    depth[0, 10, 20] = 0
    depth[0, 10, 30] = np.nan
    confidence[0, 10, 40] = 0.5
    depth[0, 10, 50] = 30.1 / 2.5
    piece = dataclasses.replace(piece, depth=depth, confidence=confidence)
    views = piece.views(max_range=30.0)
    xy = np.array([[20, 10], [30, 10], [40, 10], [50, 10], [-1, 10], [160, 10], [60, 60]])
    view = np.zeros(7, int)
    z = sample(views, view, views.to_image(view, xy))
    np.testing.assert_array_equal(z > 0, [False] * 6 + [True])


def test_beside_an_unknown_pixel_the_nearest_one_is_sampled(piece):
    depth = piece.depth.copy()
    depth[0, 60, 81] = 0
    views = dataclasses.replace(piece, depth=depth).views()
    uv = views.to_image(np.array([0]), np.array([[80.3, 60.2]]))
    z = sample(views, np.array([0]), uv)
    assert z[0] == pytest.approx(depth[0, 60, 80] * 2.5, rel=1e-6)


def test_confidence_as_bytes_is_in_255ths(piece):
    sizes = np.tile(scene.IMAGE, (6, 1))
    quarter = np.full(piece.depth.shape, 64, np.uint8)
    for threshold, usable in ((0.25, True), (0.26, False)):
        views = prepare(piece.submap, piece.depth, quarter, sizes, threshold, 100.0)
        assert views.usable.any() == usable


def test_points_agree_are_hidden_or_float_in_a_view(piece):
    views = piece.views()
    xy = np.array([[80, 70], [40, 80], [120, 75]])
    view = np.zeros(3, int)
    uv = views.to_image(view, xy)
    z = sample(views, view, uv)
    on = sight(views, lift(views, view, uv, z), 0.02)
    assert on.agrees[:, :3].all() and not on.floats.any()
    np.testing.assert_allclose(on.uv[:, 0], uv, atol=1e-3)
    within = sight(views, lift(views, view, uv, 1.015 * z), 0.02)
    assert within.agrees[:, 0].all()
    hidden = sight(views, lift(views, view, uv, 1.03 * z), 0.02)
    assert not hidden.agrees[:, 0].any() and not hidden.floats[:, 0].any()
    floating = sight(views, lift(views, view, uv, 0.97 * z), 0.02)
    assert not floating.agrees[:, 0].any() and floating.floats[:, 0].all()
    behind = sight(views, np.array([[0.0, 0, -5]]), 0.02)
    assert not behind.agrees.any() and not behind.floats.any()


def test_a_view_without_depth_sights_nothing_and_changes_no_other(piece):
    views = piece.views()
    view, xy = everywhere(views)
    uv = views.to_image(view, xy)
    p_s = lift(views, view, uv, sample(views, view, uv))
    usable = views.usable.copy()
    usable[1] = False
    full, less = (
        sight(views, p_s, 0.02),
        sight(dataclasses.replace(views, usable=usable), p_s, 0.02),
    )
    assert full.agrees[:, 1].any() and not (less.agrees[:, 1] | less.floats[:, 1]).any()
    for name in ("uv", "agrees", "floats"):
        there, here = (np.delete(getattr(found, name), 1, axis=1) for found in (full, less))
        np.testing.assert_array_equal(here, there)


def test_confirmation_needs_another_view_and_no_contradicting_majority():
    agrees = np.array([[1, 0, 0, 0], [1, 1, 0, 0], [1, 1, 0, 0], [1, 1, 1, 0]], bool)
    floats = np.array([[0, 0, 0, 0], [0, 0, 0, 1], [0, 0, 1, 1], [0, 0, 0, 1]], bool)
    sightings = Sightings(np.zeros((4, 4, 2), np.float32), agrees, floats)
    assert confirmed(sightings, np.zeros(4, int)).tolist() == [False, True, False, True]


def test_arrays_that_do_not_match_the_submap_are_errors(piece):
    sizes = np.tile(scene.IMAGE, (6, 1))
    for depth, confidence, size in (
        (piece.depth[:5], piece.confidence[:5], sizes),
        (piece.depth, piece.confidence[:, :50], sizes),
        (piece.depth[:, :1], piece.confidence[:, :1], sizes),
        (piece.depth, piece.confidence, sizes[:5]),
    ):
        with pytest.raises(MappingError, match="sub-map 0: "):
            prepare(piece.submap, depth, confidence, size, 0.5, 30.0)
