"""From camera poses in the map's world to a body in a local frame, as autopilots expect them.

Body axes are FRD: x forward, y right, z down. The mounting T_b_c says where the camera sits in the
body and how it is turned. The local frame is the body's own at the world's origin, the first
camera pose: with the right mounting its z axis is down if the car stood level there, and its x
axis is where the car pointed. Lengths are metres where the world's are.
"""

from __future__ import annotations

import numpy as np

from calm_edge.geometry import se3
from calm_edge.types import Float

# body x is camera z, body y is camera x, body z is camera y
FRD_FROM_CAMERA = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def mounting(rpy_deg: tuple[float, ...], xyz: tuple[float, ...] = (0.0, 0.0, 0.0)) -> Float:
    """T_b_c (4, 4), body <- camera, of a camera at xyz turned by yaw, then pitch, then roll.

    At (0, 0, 0) it looks straight ahead; positive angles roll right, pitch up, yaw right.
    """
    roll, pitch, yaw = np.radians(rpy_deg)
    x, y, z = np.eye(3)
    R = se3.so3_exp(z * yaw) @ se3.so3_exp(y * pitch) @ se3.so3_exp(x * roll)
    return se3.compose(R @ FRD_FROM_CAMERA, np.asarray(xyz, np.float64))


def body_pose(T_b_c: Float, T_w_c: Float) -> Float:
    """T_l_b (4, 4), local <- body, of a camera pose (4, 4) in the world."""
    # the world is the first camera, so that T_l_w is T_b_c
    return np.asarray(T_b_c @ T_w_c @ se3.inverse(T_b_c))


def body_twist(T_b_c: Float, velocity_c: Float, turn_rate_c: Float) -> tuple[Float, Float]:
    """Velocity (3,) and turn rate (3,) of the camera, in its axes -> the body's, in the body's."""
    R, lever = T_b_c[:3, :3], T_b_c[:3, 3]
    velocity, turn_rate = R @ velocity_c, R @ turn_rate_c
    # without a lever the turn rate need not be known
    if lever.any():
        velocity = velocity + np.cross(lever, turn_rate)
    return velocity, turn_rate


def quaternion(R: Float) -> tuple[float, ...]:
    """(3, 3) -> (w, x, y, z), w >= 0."""
    rotation = se3.so3_log(R)
    angle = float(np.linalg.norm(rotation))
    # sinc covers the angle of zero
    xyz = rotation * 0.5 * np.sinc(angle / 2 / np.pi)
    return (float(np.cos(angle / 2)), *xyz.tolist())


def local_covariance(T_b_c: Float, T_l_b: Float, covariance: Float) -> tuple[float, ...]:
    """A pose's (6, 6) of (translation, rotation), camera axes -> 21 values, local axes, by rows.

    The rotation is about the fixed local axes, for a car close to level its roll, pitch, yaw.
    """
    J = np.kron(np.eye(2), T_l_b[:3, :3]) @ se3.adjoint(T_b_c)
    return _upper_rows(J @ covariance @ J.T)


def body_covariance(T_b_c: Float, covariance: Float) -> tuple[float, ...]:
    """A twist's (6, 6) of (velocity, turn rate), camera axes -> 21 values, body axes, by rows."""
    J = se3.adjoint(T_b_c)
    return _upper_rows(J @ covariance @ J.T)


def _upper_rows(covariance: Float) -> tuple[float, ...]:
    return tuple(covariance[np.triu_indices(6)].tolist())
