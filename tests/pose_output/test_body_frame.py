from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from calm_edge.geometry.se3 import compose, so3_exp
from calm_edge.pose_output.body_frame import (
    body_pose,
    local_covariance,
    mounting_rotation,
    quaternion,
)

RIGHT, DOWN, FORWARD = np.eye(3)
angles = st.floats(-3.1, 3.1)


def test_a_straight_camera_sees_forward_right_down_where_the_body_has_them() -> None:
    R = mounting_rotation((0, 0, 0))
    assert np.allclose(R @ FORWARD, [1, 0, 0])
    assert np.allclose(R @ RIGHT, [0, 1, 0])
    assert np.allclose(R @ DOWN, [0, 0, 1])


@pytest.mark.parametrize(
    ("rpy_deg", "camera_axis", "body"),
    [
        ((0, 0, 90), FORWARD, [0, 1, 0]),  # yawed right: looks to the right
        ((0, 90, 0), FORWARD, [0, 0, -1]),  # pitched up: looks at the sky
        ((90, 0, 0), RIGHT, [0, 0, 1]),  # rolled right: its right side is down
        ((90, 0, 90), RIGHT, [0, 0, 1]),
        ((0, 10, 0), DOWN, [np.sin(np.radians(10)), 0, np.cos(np.radians(10))]),
    ],
)
def test_positive_angles_roll_right_pitch_up_yaw_right(
    rpy_deg: tuple[float, float, float], camera_axis: np.ndarray, body: list[float]
) -> None:
    assert np.allclose(mounting_rotation(rpy_deg) @ camera_axis, body)


@given(angles, angles, angles)
def test_mounting_is_the_aerospace_sequence(roll: float, pitch: float, yaw: float) -> None:
    expected = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    degrees = tuple(np.degrees([roll, pitch, yaw]).tolist())
    assert np.allclose(mounting_rotation(degrees), expected @ mounting_rotation((0, 0, 0)))


@pytest.mark.parametrize("rpy_deg", [(0, 0, 0), (3, -12, 40)])
def test_the_first_camera_is_the_origin_level_and_ahead(
    rpy_deg: tuple[float, float, float],
) -> None:
    position, R_l_b = body_pose(mounting_rotation(rpy_deg), np.eye(4))
    assert np.allclose(position, 0) and np.allclose(R_l_b, np.eye(3))


def test_a_tilted_camera_driving_ahead_on_level_ground_stays_level() -> None:
    # pitched down by 10 degrees, the car's forward is up in the picture
    R_b_c = mounting_rotation((0, -10, 0))
    ahead_c = R_b_c.T @ [5.0, 0, 0]
    assert ahead_c[1] < 0
    position, R_l_b = body_pose(R_b_c, compose(np.eye(3), ahead_c))
    assert np.allclose(position, [5, 0, 0]) and np.allclose(R_l_b, np.eye(3))


def test_a_right_turn_of_the_car_is_positive_yaw_and_moves_to_positive_y() -> None:
    # the camera's y axis points down: turning right about it is positive
    T_w_c = compose(so3_exp(DOWN * np.radians(30)), RIGHT * 2 + FORWARD * 7)
    position, R_l_b = body_pose(mounting_rotation((0, 0, 0)), T_w_c)
    assert np.allclose(position, [7, 2, 0])
    yaw = Rotation.from_matrix(R_l_b).as_euler("ZYX", degrees=True)[0]
    assert yaw == pytest.approx(30)


@given(angles, angles, angles)
def test_quaternion_is_scipys_with_w_first_and_not_negative(a: float, b: float, c: float) -> None:
    R = so3_exp(np.array([a, b, c]))
    expected = Rotation.from_matrix(R).as_quat(canonical=True)
    got = np.array(quaternion(R))
    assert got[0] >= 0
    # at half a turn either sign is canonical
    assert abs(abs(got @ expected[[3, 0, 1, 2]]) - 1) < 1e-9


def test_quaternion_of_no_rotation_and_of_half_a_turn() -> None:
    assert quaternion(np.eye(3)) == (1.0, 0.0, 0.0, 0.0)
    assert np.allclose(quaternion(np.diag([1.0, -1, -1])), [0, 1, 0, 0])


def test_covariance_turns_into_local_axes_by_upper_rows() -> None:
    # uncertain along the camera's view, and about its vertical axis
    covariance = np.diag([0.01, 0.02, 9.0, 0.1, 0.7, 0.2])
    level = mounting_rotation((0, 0, 0))
    got = local_covariance(level, np.eye(4), covariance)
    diagonal = [got[k] for k in (0, 6, 11, 15, 18, 20)]
    assert np.allclose(diagonal, [9, 0.01, 0.02, 0.2, 0.1, 0.7])
    turned = compose(so3_exp(DOWN * np.pi / 2), np.zeros(3))
    diagonal = [local_covariance(level, turned, covariance)[k] for k in (0, 6, 11, 15, 18, 20)]
    assert np.allclose(diagonal, [0.01, 9, 0.02, 0.1, 0.2, 0.7])


def test_covariance_agrees_with_sampled_poses() -> None:
    random = np.random.default_rng(2)
    R_b_c = mounting_rotation((4, -15, 30))
    T_w_c = compose(so3_exp(np.array([0.2, 0.9, -0.1])), np.array([3.0, 1, 8]))
    A = random.normal(size=(6, 6)) * 0.01
    covariance = A @ A.T
    noise = random.multivariate_normal(np.zeros(6), covariance, 20_000)
    _, R_l_b = body_pose(R_b_c, T_w_c)
    position = body_pose(R_b_c, T_w_c)[0]
    errors = []
    for xi in noise[:4000]:
        noisy = compose(T_w_c[:3, :3] @ so3_exp(xi[3:]), T_w_c[:3, 3] + T_w_c[:3, :3] @ xi[:3])
        p, R = body_pose(R_b_c, noisy)
        errors.append([*(p - position), *Rotation.from_matrix(R @ R_l_b.T).as_rotvec()])
    expected = np.cov(np.array(errors).T)[np.triu_indices(6)]
    got = local_covariance(R_b_c, T_w_c, covariance)
    assert np.allclose(got, expected, atol=0.1 * np.abs(covariance).max())
