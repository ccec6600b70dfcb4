"""Rendered images of maps with known content."""

import numpy as np
import pytest

from calm_edge.geometry import se3
from calm_edge.report import map_image
from tests.evaluation.worlds import curve

RED, BLUE = np.array([255, 0, 0], np.uint8), np.array([0, 0, 255], np.uint8)


def test_level_frame_undoes_the_mounting() -> None:
    tilt = se3.exp(np.array([0, 0, 0, 0.3, 0.5, -0.2]))
    flat = curve(100)
    flat[:, 1, 3] = 0
    flat[:, :3, :3] = np.eye(3)
    R = map_image.level_rotation(np.asarray(tilt @ flat))
    assert np.allclose(R @ R.T, np.eye(3), atol=1e-12) and np.linalg.det(R) == pytest.approx(1)
    level = (tilt @ flat)[:, :3, 3] @ R.T
    assert np.ptp(level[:, 2]) < 1e-9
    assert np.ptp(level[:, 0]) > np.ptp(level[:, 1])
    assert np.allclose(R @ tilt[:3, :3] @ [0, -1, 0], [0, 0, 1])


def test_nearer_points_cover_farther_ones_in_any_order() -> None:
    uv = np.array([[2.5, 1.5], [2.5, 1.5], [9.0, 9.0]])
    for order in ([0, 1, 2], [1, 0, 2]):
        depth, color = np.array([1.0, 2.0, 1.0]), np.stack([RED, BLUE, BLUE])
        image = map_image.splat(uv[order], depth[order], np.zeros(3), color[order], (5, 4))
        assert image[1, 2].tolist() == RED.tolist()
        assert (image != map_image.PAPER).any(2).sum() == 1


def test_a_radius_paints_a_square_and_stays_inside() -> None:
    image = map_image.splat(
        np.array([[0.5, 0.5], [6.5, 4.5]]),
        np.ones(2),
        np.array([1.0, 2.0]),
        np.stack([RED, BLUE]),
        (9, 7),
    )
    assert (image == RED).all(2).sum() == 4
    assert (image == BLUE).all(2).sum() == 25


def test_top_view_draws_a_point_at_to_pixels() -> None:
    path = np.stack([np.arange(0, 100, 1.0), np.zeros(100), np.zeros(100)], 1)
    rng = np.random.default_rng(0)
    ground = np.stack(
        [rng.uniform(0, 99, 20000), rng.uniform(-5, 5, 20000), np.full(20000, -1.5)], 1
    )
    # enough points not to be cut as outliers
    mark = np.tile([[50.0, 2.0, -1.0]], (700, 1))
    color = np.concatenate([np.tile(BLUE, (20000, 1)), np.tile(RED, (700, 1))])
    view = map_image.top_down(np.concatenate([ground, mark]), color, path, width=400)
    u, v = np.floor(view.to_pixels(mark[0])).astype(int)
    assert view.image[v, u].tolist() == RED.tolist()
    assert view.image.shape[1] == 400
    assert (view.image == BLUE).all(2).mean() > 0.5
    # +y (left of the path) is up in the image
    assert view.to_pixels(mark[0])[1] < view.to_pixels(path[50])[1]


def test_outliers_neither_shrink_nor_cover_the_street() -> None:
    path = np.stack([np.arange(0, 100, 1.0), np.zeros(100), np.zeros(100)], 1)
    rng = np.random.default_rng(0)
    ground = np.stack([rng.uniform(0, 99, 9900), rng.uniform(-5, 5, 9900), np.full(9900, -1.5)], 1)
    strays = rng.uniform(-900, 900, (100, 3)) + np.array([0, 0, 1000])
    color = np.concatenate([np.tile(BLUE, (9900, 1)), np.tile(RED, (100, 1))])
    view = map_image.top_down(np.concatenate([ground, strays]), color, path, width=300)
    assert 300 * view.pixel < 115
    assert not (view.image == RED).all(2).any()


def test_eye_height_is_the_height_above_the_road() -> None:
    path = np.stack([np.arange(0, 60, 1.0), np.zeros(60), np.zeros(60)], 1)
    rng = np.random.default_rng(0)
    road = np.stack([rng.uniform(0, 60, 5000), rng.uniform(-4, 4, 5000), np.full(5000, -1.4)], 1)
    wall = np.stack([rng.uniform(0, 60, 5000), np.full(5000, 6.0), rng.uniform(-1, 6, 5000)], 1)
    points = np.concatenate([road, wall])
    assert map_image.eye_height(points, path) == pytest.approx(1.4)
    color = np.concatenate([np.tile(BLUE, (5000, 1)), np.tile(RED, (5000, 1))])
    picture = map_image.best_chases(points, color, path, count=1)[0]
    left, right = picture[:, :600], picture[:, 600:]
    # looking along +x, the wall at y = +6 is on the left
    assert (left == RED).all(2).sum() > 10 * max((right == RED).all(2).sum(), 1)
    assert (picture[300:] == BLUE).all(2).any()
