import numpy as np
import pytest

from bench.scripted.street import CAMERA_HEIGHT_M, Street
from calm_edge.geometry.camera import Perspective
from tests.drives import circle, curved

CAMERA = Perspective.from_hfov(80, 640, 200)
UV = np.stack(np.meshgrid(np.arange(0, 640, 16), np.arange(0, 200, 8)), -1).reshape(-1, 2) * 1.0


def cast(street, T):
    rays = CAMERA.back_project(UV, np.ones(len(UV))) @ T[:3, :3].T
    z = street.depth(rays, T[:3, 3])
    return z, T[:3, 3] + rays * np.where(np.isfinite(z), z, 0.0)[:, None]


@pytest.fixture(scope="module")
def drive():
    T = curved(80)
    return T, Street.along(T)


def test_the_road_lies_below_the_camera_and_facades_beside_it(drive):
    T, street = drive
    p = T[:, :3, 3]
    down = street.depth(np.tile([0.0, 1.0, 0.0], (len(p), 1)), p)
    assert np.all((down > CAMERA_HEIGHT_M - 0.6) & (down < CAMERA_HEIGHT_M + 1.0))
    right = T[:, :3, :3] @ [1.0, 0, 0]
    for side in (right, -right):
        away = street.depth(side, p)
        assert np.mean(np.isfinite(away)) > 0.6
        assert np.all(away[np.isfinite(away)] > 3.0) and np.nanmin(away) < 14.0
    assert np.all(np.isinf(street.depth(np.tile([0.0, -1.0, 0.1], (len(p), 1)), p)))


def test_what_one_view_hits_hides_nothing_nearer_from_the_next(drive):
    T, street = drive
    z, p_w = cast(street, T[30])
    hit = np.isfinite(z)
    assert 0.6 < hit.mean() < 0.98
    assert len(np.unique(np.round(z[hit]))) > 10
    centre = T[31, :3, 3]
    again = street.depth(p_w[hit] - centre, centre)
    # a multiple of 1 is the very point; a smaller one is a surface in front of it
    assert np.mean(np.abs(again - 1) < 0.02) > 0.85
    assert again.min() > 0.02


def test_where_the_path_comes_back_higher_the_camera_stays_above_the_road():
    T = np.concatenate([circle(60), circle(60)])
    T[60:, 1, 3] -= 2.0
    street = Street.along(T)
    down = street.depth(np.tile([0.0, 1.0, 0.0], (120, 1)), T[:, :3, 3])
    assert down.min() > 1.0


def test_equal_paths_are_equal_streets_and_another_seed_another(drive):
    T, street = drive
    again, other = Street.along(T), Street.along(T, seed=1)
    assert np.array_equal(street.clear, again.clear)
    assert not np.array_equal(street.clear, other.clear)


def test_a_ray_along_the_road_goes_beyond_its_range():
    T = np.tile(np.eye(4), (200, 1, 1))
    T[:, 2, 3] = np.arange(200.0)
    street = Street.along(T)
    assert np.isinf(street.depth(np.array([[0.0, -0.001, 1.0]]), T[0, :3, 3]))[0]
