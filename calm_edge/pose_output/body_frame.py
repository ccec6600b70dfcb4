"""From camera poses in the map's world to a body in a local frame, as autopilots expect them.

Body axes are FRD: x forward, y right, z down. The local frame is the body frame of the first
camera pose, the world's origin: with the camera's mounting angles given it is level if the car
stood level there, and its x axis is where the car pointed. Only the rotation of the mounting is
known, so the body's origin is the camera.
"""

from __future__ import annotations

import numpy as np

from calm_edge.geometry.se3 import so3_exp, so3_log
from calm_edge.types import Float

# body x is camera z, body y is camera x, body z is camera y
_FRD_FROM_CAMERA = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def mounting_rotation(rpy_deg: tuple[float, float, float]) -> Float:
    """R_b_c (3, 3), body <- camera, of a camera turned by yaw, then pitch, then roll in the body.

    At (0, 0, 0) it looks straight ahead; positive angles roll right, pitch up, yaw right.
    """
    roll, pitch, yaw = np.radians(rpy_deg)
    x, y, z = np.eye(3)
    R = so3_exp(z * yaw) @ so3_exp(y * pitch) @ so3_exp(x * roll)
    return np.asarray(R @ _FRD_FROM_CAMERA)


def body_pose(R_b_c: Float, T_w_c: Float) -> tuple[Float, Float]:
    """Camera pose (4, 4) in the world -> position (3,) and R_l_b (3, 3) in the local frame."""
    # the world is the first camera, so that R_l_w is R_b_c
    return R_b_c @ T_w_c[:3, 3], np.asarray(R_b_c @ T_w_c[:3, :3] @ R_b_c.T)


def quaternion(R: Float) -> tuple[float, ...]:
    """(3, 3) -> (w, x, y, z), w >= 0."""
    rotation = so3_log(R)
    angle = float(np.linalg.norm(rotation))
    # sinc covers the angle of zero
    xyz = rotation * 0.5 * np.sinc(angle / 2 / np.pi)
    return (float(np.cos(angle / 2)), *xyz.tolist())


def local_covariance(R_b_c: Float, T_w_c: Float, covariance: Float) -> tuple[float, ...]:
    """(6, 6) of (translation, rotation) in camera axes -> 21 values in local axes, by rows.

    The rotation is about the fixed local axes, for a car close to level its roll, pitch, yaw.
    """
    R = np.kron(np.eye(2), R_b_c @ T_w_c[:3, :3])
    local = R @ covariance @ R.T
    return tuple(local[np.triu_indices(6)].tolist())
