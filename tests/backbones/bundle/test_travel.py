"""The path of a car from matches alone: turns, direction of travel and signed steps."""

import numpy as np
import pytest

from calm_edge.backbones.bundle import travel
from calm_edge.backbones.bundle.problem import Measurements
from calm_edge.geometry import se3

F_PX, SIZE = 450.0, np.array([[640, 360], [640, 360]])
NOISE_PX, OUTLIERS = 0.3, 0.1


def path_of(steps, turn_deg, direction):
    """T_w_c of a car that moves by signed steps along `direction` and turns with each."""
    T = [np.eye(4)]
    for step, degrees in zip(steps, turn_deg, strict=True):
        w = np.radians([0.0, degrees, 0.0])
        T.append(T[-1] @ se3.compose(se3.so3_exp(w), step * (se3.so3_exp(w / 2) @ direction)))
    return np.stack(T)


def seen_from(T_w_c, seed=0, n=600):
    """Measurements of the primary and rays (O, 2): points beside, above and far ahead of a road."""
    rng = np.random.default_rng(seed)
    p_w = np.c_[rng.uniform(-25, 25, n), rng.uniform(-6, 1.5, n), rng.uniform(-40, 120, n)]
    p_w[: n // 5] = rng.uniform([-400, -60, 300], [400, -5, 900], (n // 5, 3))
    rows = []
    for view, T in enumerate(T_w_c):
        p_c = se3.transform(se3.inverse(T), p_w)
        with np.errstate(divide="ignore", invalid="ignore"):
            xy = p_c[:, :2] / p_c[:, 2:]
        seen = (p_c[:, 2] > 2) & (np.abs(xy) < [0.7, 0.4]).all(1)
        for point in np.flatnonzero(seen):
            rows.append((view, point, *xy[point]))
    view, point = (np.array([r[k] for r in rows]) for k in (0, 1))
    rays = np.array([r[2:] for r in rows]) + rng.normal(0, NOISE_PX / F_PX, (len(rows), 2))
    wrong = rng.random(len(rays)) < OUTLIERS
    rays[wrong] += rng.normal(0, 20 / F_PX, (wrong.sum(), 2))
    eye, t = np.zeros(len(T_w_c), int), 0.3 * np.arange(len(T_w_c))
    m = Measurements(view, point, rays * F_PX, np.ones(len(rays)), eye, t, SIZE)
    return m, rays


def driven(m, rays, remembered=None):
    """T_c_s of the course that is tried first."""
    matches = travel.matches(m, rays, F_PX)
    course = travel.courses(matches, remembered)[0]
    return course.path(travel.signed_steps(matches, course))


def found(T_w_c, seed=0, remembered=None):
    """Relative poses (P, 4, 4) as the start has them, and true ones."""
    m, rays = seen_from(T_w_c, seed)
    T_s_c = se3.inverse(driven(m, rays, remembered))
    return se3.inverse(T_s_c[:-1]) @ T_s_c[1:], se3.inverse(T_w_c[:-1]) @ T_w_c[1:]


def turn_errors_deg(T, T_true):
    off = T_true[:, :3, :3].transpose(0, 2, 1) @ T[:, :3, :3]
    return np.degrees(np.linalg.norm(se3.so3_log(off), axis=1))


AHEAD = np.array([0.0, 0.0, 1.0])
STEPS = np.full(12, 2.0)


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize(
    "steps, turns",
    [(STEPS, np.zeros(12)), (STEPS, np.full(12, 3.0)), (-STEPS / 2, np.linspace(0, 4, 12))],
    ids=["straight", "arc", "reverse"],
)
def test_turns_and_steps_of_a_drive(steps, turns, seed):
    T, T_true = found(path_of(steps, turns, AHEAD), seed)
    assert turn_errors_deg(T, T_true).max() < 0.25
    length = T[:, 2, 3] / np.median(np.abs(T[:, 2, 3]))
    assert np.allclose(length, steps / np.abs(steps[0]), atol=0.35)


def test_a_camera_that_looks_past_the_direction_of_travel_by_four_degrees():
    direction = np.array([0.06, -0.04, 1.0])
    direction /= np.linalg.norm(direction)
    T, T_true = found(path_of(STEPS, np.full(12, 1.0), direction))
    assert turn_errors_deg(T, T_true).max() < 0.25
    moved = T[:, :3, 3] / np.linalg.norm(T[:, :3, 3], axis=1, keepdims=True)
    true = T_true[:, :3, 3] / np.linalg.norm(T_true[:, :3, 3], axis=1, keepdims=True)
    assert np.degrees(np.arccos((moved * true).sum(1))).max() < 3


@pytest.mark.parametrize("yaw_deg, pitch_deg", [(-15, 0), (15, 5), (25, -8), (-40, 0), (55, 0)])
def test_a_mount_turned_far_from_the_direction_of_travel_is_found(yaw_deg, pitch_deg):
    """40 degrees and more are outside the picture, whose edge is at 35."""
    yaw, pitch = np.radians([yaw_deg, pitch_deg])
    direction = np.array([np.sin(yaw) * np.cos(pitch), np.sin(pitch), np.cos(yaw) * np.cos(pitch)])
    m, rays = seen_from(path_of(STEPS, np.linspace(-2, 3, 12), direction), seed=4)
    course = travel.courses(travel.matches(m, rays, F_PX), None)[0]
    assert np.degrees(np.arccos(course.direction @ direction)) < 2.5


def test_a_remembered_direction_holds_where_the_pictures_say_little():
    """Slow, and nearly all points far: a search ends anywhere."""
    m, rays = seen_from(path_of(np.full(12, 0.05), np.zeros(12), AHEAD), seed=1)
    courses = travel.courses(travel.matches(m, rays, F_PX), AHEAD)
    assert len(courses) == 1
    assert np.degrees(np.arccos(courses[0].direction @ AHEAD)) < 4


def test_a_three_point_turn_changes_the_sign_of_its_steps():
    steps = np.r_[np.full(5, 1.5), 0.3, -0.3, np.full(5, -1.5)]
    T, T_true = found(path_of(steps, np.full(12, 4.0), AHEAD))
    assert turn_errors_deg(T, T_true).max() < 0.4
    moving = np.abs(steps) > 1
    assert (np.sign(T[moving, 2, 3]) == np.sign(steps[moving])).all()


def test_pulling_away_from_a_stop():
    steps = np.r_[np.zeros(4), np.linspace(0.3, 2.4, 8)]
    T, T_true = found(path_of(steps, np.zeros(12), AHEAD))
    assert turn_errors_deg(T, T_true).max() < 0.25
    length = T[:, 2, 3] / T[-1, 2, 3]
    assert np.abs(length[:4]).max() < 0.35 and np.allclose(length[6:], steps[6:] / 2.4, atol=0.2)


def test_a_car_that_stands_has_a_path_nonetheless():
    T, _ = found(path_of(np.zeros(8), np.zeros(8), AHEAD))
    assert np.isfinite(T).all()
    assert turn_errors_deg(T, np.tile(np.eye(4), (8, 1, 1))).max() < 0.1


def test_neighbours_that_share_nothing_keep_no_turn():
    m, rays = seen_from(path_of(STEPS, np.zeros(12), AHEAD))
    point = np.where(m.view >= 6, m.point + 1000, m.point)
    split = Measurements(m.view, point, m.uv, m.sigma_px, m.eye, m.t, m.size)
    T = driven(split, rays, AHEAD)
    assert np.isfinite(T).all()
    step = T[5] @ se3.inverse(T[6])
    assert np.allclose(step[:3, :3], np.eye(3), atol=1e-6)
