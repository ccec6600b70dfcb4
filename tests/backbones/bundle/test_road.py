from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calm_edge.backbones.bundle import problem
from calm_edge.backbones.bundle.initialise import on_rig, triangulated
from calm_edge.backbones.bundle.road import Pairs, fitted, pairs, with_road
from calm_edge.geometry import se3
from calm_edge.kit import layout
from tests.backbones.bundle import road_pictures as road
from tests.backbones.bundle.exact_window import theta_of

SIZE = np.array([[640, 360], [640, 360]])
VIEWS, STEP = 6, 2.5
AHEAD = np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def window():
    """Far points seen in all views, road points in one view of each eye; true state; pictures."""
    rng = np.random.default_rng(2)
    theta = theta_of(rotation_deg=(0.5, -1.0, 0.3))
    theta[layout.RIG_CENTRE] = [1.0, 0.0, 0.0]
    eye = np.repeat([0, 1], VIEWS)
    t = np.tile(0.2 * np.arange(VIEWS), 2)
    none = np.zeros(0, int)
    m = problem.Measurements(none, none, np.zeros((0, 2)), np.zeros(0), eye, t, SIZE)
    T_c_s = on_rig(m, theta, se3.inverse(road.drive(VIEWS, STEP)))
    cameras = layout.cameras(theta, SIZE)
    rays = rng.uniform([-0.5, -0.3, 1], [0.5, -0.02, 1], (120, 3))
    rows = []
    for view in range(2 * VIEWS):
        camera = cameras[eye[view]]
        uv = camera.project((rays * 400) @ T_c_s[view, :3, :3].T + T_c_s[view, :3, 3])
        inside = ((uv > 0) & (uv < [639, 359])).all(1)
        rows += [(view, k, *uv[k]) for k in np.flatnonzero(inside)]
    n = len(rays)
    for view in range(VIEWS):
        uv = rng.uniform([60, 250], [580, 320], (40, 2))
        ray = cameras[0].rays(uv) @ np.linalg.inv(T_c_s[view])[:3, :3].T
        centre = np.linalg.inv(T_c_s[view])[:3, 3]
        X = centre + ray * ((road.HEIGHT - centre[1]) / ray[:, 1])[:, None]
        other = view + VIEWS
        there = cameras[1].project(X @ T_c_s[other, :3, :3].T + T_c_s[other, :3, 3])
        for k in np.flatnonzero(((there > 0) & (there < [639, 359])).all(1)):
            rows += [(view, n, *uv[k]), (other, n, *there[k])]
            n += 1
    rows = np.array(sorted(rows))
    every = replace(
        m, view=rows[:, 0].astype(int), point=rows[:, 1].astype(int), uv=rows[:, 2:],
        sigma_px=np.full(len(rows), 0.5), edge=np.zeros((len(rows), 2)),
    )  # fmt: skip
    state = problem.State(T_c_s, np.zeros((0, 4)), theta)
    texture = road.asphalt()
    pictures = [
        road.picture(texture, np.linalg.inv(T), cameras[0], seed=k)
        for k, T in enumerate(T_c_s[:VIEWS])
    ]
    return every, state, pictures


def at_half_speed(every, state):
    T_p_s = state.T_c_s[every.eye == 0].copy()
    T_p_s[:, :3, 3] /= 2
    return replace(state, T_c_s=on_rig(every, state.theta, T_p_s))


def test_points_that_one_view_of_each_eye_has_seen_are_triangulated(window):
    every, state, _ = window
    found = pairs(every, state)
    assert len(found.view) > 150
    T_s_c = np.linalg.inv(state.T_c_s[found.view])
    X = (
        T_s_c
        @ np.c_[found.rays / found.inverse_depth[:, None], np.ones(len(found.view))][..., None]
    )
    np.testing.assert_allclose(X[:, 1, 0], road.HEIGHT, atol=1e-6)


def test_the_plane_of_the_road_is_fitted_among_outliers():
    rng = np.random.default_rng(0)
    rays = rng.uniform([-0.5, 0.2, 1], [0.5, 0.6, 1], (200, 3))
    normal = np.array([0.02, 1.0, 0.03]) / 2.5
    depth = rays @ normal + rng.normal(size=200) * 1e-3
    depth[:80] = rng.uniform(0.05, 0.3, 80)
    count = np.zeros(200, int)
    found = fitted(Pairs(count, rays[:, :2], count, rays, depth), AHEAD, 4e-3)
    assert found is not None
    np.testing.assert_allclose(found[0], normal, atol=2e-3)
    assert found[1][80:].mean() > 0.95


@pytest.mark.parametrize("facing", [(0.0, 0.2, 0.5), (0.0, 0.0, 0.1)])
def test_a_wall_across_the_way_is_no_road(facing):
    rays = np.random.default_rng(1).uniform([-0.5, 0.2, 1], [0.5, 0.6, 1], (200, 3))
    count = np.zeros(200, int)
    assert fitted(Pairs(count, rays[:, :2], count, rays, rays @ facing), AHEAD, 1e-4) is None


def test_the_road_shows_the_speed_that_far_points_do_not(window):
    every, state, pictures = window
    found = with_road(every, at_half_speed(every, state), pictures, None)
    assert found is not None
    m, start = found
    steps = np.linalg.norm(np.diff(se3.inverse(start.T_c_s[:VIEWS])[:, :3, 3], axis=0), axis=1)
    np.testing.assert_allclose(steps, STEP, rtol=0.1)
    followed = np.unique(m.point).size - 120
    assert followed > 60
    assert np.all(np.diff(m.view) >= 0) and len(start.points) == m.point.max() + 1


def test_followed_points_are_where_the_true_poses_see_them(window):
    every, state, pictures = window
    m, _ = with_road(every, at_half_speed(every, state), pictures, None)
    true = replace(state, points=triangulated(m, state.T_c_s, state.theta))
    error = np.linalg.norm(problem.project(true, m)[0] - m.uv, axis=1)
    assert np.median(error) < 0.3 and np.percentile(error, 95) < 1.5


def test_a_road_without_texture_changes_nothing(window):
    every, state, pictures = window
    even = [np.full_like(picture, 128) for picture in pictures]
    assert with_road(every, at_half_speed(every, state), even, None) is None
