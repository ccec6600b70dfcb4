from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from calm_edge.geometry import se3
from calm_edge.geometry.body_frame import (
    body_covariance,
    body_pose,
    body_twist,
    local_covariance,
    mounting,
)
from calm_edge.geometry.se3 import compose, so3_exp

RIGHT, DOWN, FORWARD = np.eye(3)
angles = st.floats(-3.1, 3.1)


def test_a_camera_mounted_straight_maps_its_axes_to_forward_right_down() -> None:
    R = mounting((0, 0, 0))[:3, :3]
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
    assert np.allclose(mounting(rpy_deg)[:3, :3] @ camera_axis, body)


@given(angles, angles, angles)
def test_mounting_is_the_aerospace_sequence(roll: float, pitch: float, yaw: float) -> None:
    expected = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    degrees = tuple(np.degrees([roll, pitch, yaw]).tolist())
    assert np.allclose(mounting(degrees)[:3, :3], expected @ mounting((0, 0, 0))[:3, :3])


def test_mounting_sets_the_camera_position() -> None:
    T_b_c = mounting((0, -10, 20), (1.5, -0.25, -1.25))
    assert np.allclose(se3.transform(T_b_c, np.zeros(3)), [1.5, -0.25, -1.25])


@pytest.mark.parametrize("xyz", [(0, 0, 0), (1.5, 0.5, -1)])
@pytest.mark.parametrize("rpy_deg", [(0, 0, 0), (3, -12, 40)])
def test_the_first_body_pose_is_the_identity(
    rpy_deg: tuple[float, float, float], xyz: tuple[float, float, float]
) -> None:
    assert np.allclose(body_pose(mounting(rpy_deg, xyz), np.eye(4)), np.eye(4))


def test_driving_on_level_ground_stays_level_with_a_tilted_camera() -> None:
    # pitched down by 10 degrees, the car's forward direction is up in the image
    T_b_c = mounting((0, -10, 0))
    ahead_c = T_b_c[:3, :3].T @ [5.0, 0, 0]
    assert ahead_c[1] < 0
    T_l_b = body_pose(T_b_c, compose(np.eye(3), ahead_c))
    assert np.allclose(T_l_b, compose(np.eye(3), np.array([5.0, 0, 0])))


def test_a_right_turn_is_positive_yaw_and_positive_y() -> None:
    # the camera's y axis points down, so a right turn about it is positive
    T_w_c = compose(so3_exp(DOWN * np.radians(30)), RIGHT * 2 + FORWARD * 7)
    T_l_b = body_pose(mounting((0, 0, 0)), T_w_c)
    assert np.allclose(T_l_b[:3, 3], [7, 2, 0])
    yaw = Rotation.from_matrix(T_l_b[:3, :3]).as_euler("ZYX", degrees=True)[0]
    assert yaw == pytest.approx(30)


def test_a_car_turning_on_the_spot_has_zero_body_velocity() -> None:
    # a camera one metre ahead of the axle moves to the right, the body's origin does not move
    T_b_c = mounting((0, 0, 0), (1, 0, 0))
    yaw = so3_exp(DOWN * np.radians(90))
    T_w_c = compose(yaw, RIGHT - FORWARD)
    assert np.allclose(body_pose(T_b_c, T_w_c)[:3, 3], 0)
    velocity, turn_rate = body_twist(T_b_c, RIGHT * 0.5, DOWN * 0.5)
    assert np.allclose(velocity, 0) and np.allclose(turn_rate, [0, 0, 0.5])


def test_body_velocity_is_the_derivative_of_the_body_pose() -> None:
    random = np.random.default_rng(4)
    T_b_c = mounting((4, -15, 30), (1.2, -0.4, -1.1))
    T_w_c = se3.exp(random.normal(size=6))
    twist_c = random.normal(size=6)
    step = 1e-6
    T_before, T_after = (body_pose(T_b_c, T_w_c @ se3.exp(k * step * twist_c)) for k in (-1, 1))
    moved = se3.log(se3.inverse(T_before) @ T_after) / (2 * step)
    assert np.allclose(np.concatenate(body_twist(T_b_c, twist_c[:3], twist_c[3:])), moved)


def test_velocity_without_lever_arm_needs_no_turn_rate() -> None:
    unknown = np.full(3, np.nan)
    velocity, turn_rate = body_twist(mounting((0, 0, 0)), FORWARD, unknown)
    assert np.allclose(velocity, [1, 0, 0]) and np.isnan(turn_rate).all()
    assert np.isnan(body_twist(mounting((0, 0, 0), (1, 0, 0)), FORWARD, unknown)[0]).any()


def test_pose_covariance_is_rotated_to_local_axes() -> None:
    # uncertain along the optical axis, and about the vertical axis
    covariance = np.diag([0.01, 0.02, 9.0, 0.1, 0.7, 0.2])
    level = mounting((0, 0, 0))
    diagonal = [0, 6, 11, 15, 18, 20]
    got = np.array(local_covariance(level, np.eye(4), covariance))
    assert np.allclose(got[diagonal], [9, 0.01, 0.02, 0.2, 0.1, 0.7])
    assert np.allclose(np.array(body_covariance(level, covariance)), got)
    turned = body_pose(level, compose(so3_exp(DOWN * np.pi / 2), np.zeros(3)))
    got = np.array(local_covariance(level, turned, covariance))
    assert np.allclose(got[diagonal], [0.01, 9, 0.02, 0.1, 0.2, 0.7])


def test_a_lever_arm_turns_yaw_uncertainty_into_position_uncertainty() -> None:
    # yaw about a camera two metres ahead moves the body's origin sideways
    T_b_c = mounting((0, 0, 0), (2, 0, 0))
    got = local_covariance(T_b_c, np.eye(4), np.diag([0, 0, 0, 0, 0.01, 0.0]))
    assert got[6] == pytest.approx(0.04) and got[20] == pytest.approx(0.01)


@pytest.mark.parametrize("xyz", [(0, 0, 0), (1.5, 0.5, -1)])
def test_covariances_agree_with_sampled_poses_and_twists(xyz: tuple[float, float, float]) -> None:
    random = np.random.default_rng(2)
    T_b_c = mounting((4, -15, 30), xyz)
    T_w_c = compose(so3_exp(np.array([0.2, 0.9, -0.1])), np.array([3.0, 1, 8]))
    A = random.normal(size=(6, 6)) * 0.01
    covariance = A @ A.T
    noise = random.multivariate_normal(np.zeros(6), covariance, 4000)
    T_l_b = body_pose(T_b_c, T_w_c)
    pose_errors, twist_errors = [], []
    for xi in noise:
        noisy = compose(T_w_c[:3, :3] @ so3_exp(xi[3:]), T_w_c[:3, 3] + T_w_c[:3, :3] @ xi[:3])
        T = body_pose(T_b_c, noisy)
        rotation = Rotation.from_matrix(T[:3, :3] @ T_l_b[:3, :3].T).as_rotvec()
        pose_errors.append([*(T[:3, 3] - T_l_b[:3, 3]), *rotation])
        twist_errors.append(np.concatenate(body_twist(T_b_c, xi[:3], xi[3:])))
    for errors, got in (
        (pose_errors, local_covariance(T_b_c, T_l_b, covariance)),
        (twist_errors, body_covariance(T_b_c, covariance)),
    ):
        expected = np.cov(np.array(errors).T)
        assert np.allclose(got, expected[np.triu_indices(6)], atol=0.1 * np.abs(expected).max())
