"""Convert camera poses and twists in the world to those of the body in a local FRD frame.

Body axes are FRD: x forward, y right, z down. T_b_c is the mounting of the camera in the body.
The local frame is the body frame at the world's origin, the first camera pose: with the right
mounting its x axis points along the car, and its z axis down if the car stood level there. Lengths
are in world units.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calm_edge.geometry import se3

Float = NDArray[np.float64]

# body x is camera z, body y is camera x, body z is camera y
FLU_FROM_FRD = np.diag([1.0, -1.0, -1.0, 1.0])
FRD_FROM_CAMERA = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def mounting(rpy_deg: tuple[float, ...], xyz: tuple[float, ...] = (0.0, 0.0, 0.0)) -> Float:
    """Return T_b_c (4, 4) of a camera at xyz, rotated by yaw, then pitch, then roll.

    With rpy_deg (0, 0, 0) the camera looks straight ahead; positive angles roll right, pitch up,
    yaw right.
    """
    roll, pitch, yaw = np.radians(rpy_deg)
    x, y, z = np.eye(3)
    R = se3.so3_exp(z * yaw) @ se3.so3_exp(y * pitch) @ se3.so3_exp(x * roll)
    return se3.compose(R @ FRD_FROM_CAMERA, np.asarray(xyz, np.float64))


def body_pose(T_b_c: Float, T_w_c: Float) -> Float:
    """Return the body pose T_l_b (4, 4) in the local frame for a camera pose T_w_c (4, 4)."""
    # the world is the first camera's frame, so T_l_w = T_b_c
    return np.asarray(T_b_c @ T_w_c @ se3.inverse(T_b_c))


def body_twist(T_b_c: Float, velocity_c: Float, turn_rate_c: Float) -> tuple[Float, Float]:
    """Convert a camera's velocity (3,) and turn rate (3,) in camera axes to the body's."""
    R, lever = T_b_c[:3, :3], T_b_c[:3, 3]
    velocity, turn_rate = R @ velocity_c, R @ turn_rate_c
    # skipped if the camera is at the body's origin: a NaN turn rate then leaves the velocity valid
    if lever.any():
        velocity = velocity + np.cross(lever, turn_rate)
    return velocity, turn_rate


def local_jacobian(T_b_c: Float, T_l_b: Float) -> Float:
    """Jacobian (6, 6) of a small motion in local axes by that in camera axes, both (t, r)."""
    return np.asarray(np.kron(np.eye(2), T_l_b[:3, :3]) @ se3.adjoint(T_b_c))


def local_covariance(T_b_c: Float, T_l_b: Float, covariance: Float) -> tuple[float, ...]:
    """Transform a pose covariance (6, 6) in camera axes to local axes; upper triangle by rows (21).

    Order (translation, rotation). The rotation is about the fixed local axes: approximately roll,
    pitch and yaw while the car is nearly level.
    """
    J = local_jacobian(T_b_c, T_l_b)
    return _upper_rows(J @ covariance @ J.T)


def body_covariance(T_b_c: Float, covariance: Float) -> tuple[float, ...]:
    """Transform a twist covariance (6, 6) in camera axes to body axes; upper triangle by rows (21).

    Order (velocity, turn rate).
    """
    J = se3.adjoint(T_b_c)
    return _upper_rows(J @ covariance @ J.T)


def _upper_rows(covariance: Float) -> tuple[float, ...]:
    return tuple(covariance[np.triu_indices(6)].tolist())
