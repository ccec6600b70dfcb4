"""What a wrong focal did to a relative pose, taken back (paper V-B).

A pose is T_a_b (p_a = R p_b + t), its essential matrix E = [t]x R, so x_a^T K^-T E K^-1 x_b = 0.
S = diag(s_x, s_y, 1) holds the ratios of the estimated focals to the true ones. The paper writes it
K_est K^-1, which is diagonal in pixels counted from the principal point: both K share that point,
and an error of it is none that this model can express.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera
from calm_edge.types import Float

_I = np.eye(3)


def damped_scaling(estimated: Camera, held: Camera, damping: float) -> Float:
    """S' (3, 3) = I + damping (S - I), the part of the focal's error that is to be taken back.

    Principal points are not looked at. damping: in [0, 1]. Paper V-B, last paragraph of V-C.
    """
    ratio = np.array([estimated.fx / held.fx, estimated.fy / held.fy])
    return np.diag([*(1 + damping * (ratio - 1)), 1.0])


def effective_camera(estimated: Camera, S: Float) -> Camera:
    """The camera that poses corrected by S (3, 3) belong to: f_est / s an axis.

    The principal point stays as estimated. With S damped the focal stays between the estimated and
    the held one.
    """
    s_x, s_y, _ = np.diagonal(S).tolist()
    return replace(estimated, fx=estimated.fx * (1 / s_x), fy=estimated.fy * (1 / s_y))


def translation_simple(t: Float, S: Float) -> Float:
    """S t, (..., 3) in the unit of t: right where the rotation is small (V-B)."""
    return np.asarray((S @ t[..., None])[..., 0])


def translation_general(t: Float, R: Float, S: Float) -> Float:
    """The skew part of M = S^-1 [t]x R S^-1 R^-1, times s_x s_y: (..., 3) in the unit of t (V-B).

    t (..., 3), R and S (..., 3, 3). As s_x s_y M = [S t]x (S R S^-1 R^-1), the factor that the
    paper derives for R = I is right for every R: the bracket has trace 3 up to the square of
    (focal error x rotation). Setting t_z to what was estimated would say the same where
    t_z is large, and nothing where the motion is sideways.
    """
    S_inverse = np.linalg.inv(S)
    M = S_inverse @ se3.hat(t) @ R @ S_inverse @ np.swapaxes(R, -1, -2)
    skew = (M - np.swapaxes(M, -1, -2)) / 2
    raw = np.stack([skew[..., 2, 1], skew[..., 0, 2], skew[..., 1, 0]], -1)
    return np.asarray(np.linalg.det(S)[..., None] * raw)


def rotation_error(t: Float, R: Float, S: Float) -> Float:
    """Theta (..., 3) rad: the rotation vector by which R is wrong, to first order in S - I (V-B).

    t (..., 3), R and S (..., 3, 3). Only the direction of t matters. Zero where t is zero: without
    a baseline the epipolar constraint says nothing of it. Theta has no part along t.
    """
    length = np.linalg.norm(t, axis=-1, keepdims=True)
    u = t / np.where(length > 0, length, 1.0)
    delta = S - _I
    turned = R @ delta @ np.swapaxes(R, -1, -2) - delta
    return np.asarray(np.cross(u, (turned @ u[..., None])[..., 0]))


def corrected_rotation(t: Float, R: Float, S: Float) -> Float:
    """Rodrigues(Theta)^T R, (..., 3, 3), of the estimated t (..., 3) and R (..., 3, 3) (V-B)."""
    return np.asarray(se3.so3_exp(-rotation_error(t, R, S)) @ R)
