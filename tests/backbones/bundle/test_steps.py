"""Velocities of a window's steps as shares of its speed."""

import numpy as np

from calm_edge.backbones.bundle.steps import Steps, speed
from calm_edge.geometry import se3
from tests.backbones.bundle.exact_window import PERIOD_S, theta_of, window


def arc(n, step):
    T = [np.eye(4)]
    for _ in range(n - 1):
        T.append(T[-1] @ se3.exp(np.array(step)))
    return np.array(T)


def test_on_an_arc_the_velocity_is_that_of_the_camera_in_its_own_axes():
    made = window(arc(5, [0.1, 0.0, 3.0, 0.0, 0.2, 0.0]), theta_of(), n_points=25)
    steps = Steps.of(made.m)
    assert np.allclose(steps.velocities(made.truth.T_c_s), np.array([-0.1, 0, -3]) / PERIOD_S)


def test_shares_do_not_change_with_the_scale():
    made = window(arc(5, [0.1, 0.0, 3.0, 0.0, 0.2, 0.0]), theta_of(), n_points=25)
    larger = made.truth.T_c_s.copy()
    larger[:, :3, 3] *= 40
    steps = Steps.of(made.m)
    assert np.allclose(steps.shares(larger), steps.shares(made.truth.T_c_s), atol=1e-9)


def test_the_speed_is_that_of_the_part_in_which_the_car_moves():
    waiting = np.array([[0, 0, 0.0]] * 9 + [[0, 0, 4.0]])
    assert 2 < speed(waiting) < 4
    assert speed(np.zeros((4, 3))) > 0
