"""Correction of relative poses for an error of the focal length (paper V-B).

A pose is T_a_b (p_a = R p_b + t), its essential matrix E = [t]x R, x_a^T K^-T E K^-1 x_b = 0.
S = diag(s_x, s_y, 1) are the ratios of estimated to true focals, K_est K^-1 in the paper, which is
diagonal for pixel coordinates relative to a common principal point; an error of that point is not
modelled.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera
from calm_edge.types import Float

_I = np.eye(3)


def damped_scaling(estimated: Camera, target: Camera, damping: float) -> Float:
    """S' (3, 3) = I + damping (S - I), S the ratios of estimated to target focals (V-B, V-C).

    target: the global estimate, K_global. damping: in [0, 1]. Principal points are ignored.
    """
    ratio = np.array([estimated.fx / target.fx, estimated.fy / target.fy])
    return np.diag([*(1 + damping * (ratio - 1)), 1.0])


def effective_camera(estimated: Camera, S: Float) -> Camera:
    """Camera consistent with poses corrected by S (3, 3): focals divided by s_x and s_y.

    With damping these are between the estimated and the target's. The principal point is kept.
    """
    s_x, s_y, _ = np.diagonal(S).tolist()
    return replace(estimated, fx=estimated.fx * (1 / s_x), fy=estimated.fy * (1 / s_y))


def translation_simple(t: Float, S: Float) -> Float:
    """Corrected translation S t (..., 3), for small rotations (simplified form of V-B).

    t: (..., 3), estimated. S: (..., 3, 3) focal ratios.
    """
    return np.asarray((S @ t[..., None])[..., 0])


def translation_general(t: Float, R: Float, S: Float) -> Float:
    """Corrected translation (..., 3): skew part of M = S^-1 [t]x R S^-1 R^-1, times s_x s_y (V-B).

    t: (..., 3). R, S: (..., 3, 3). The paper derives the factor s_x s_y for R = I, but because of
    s_x s_y M = [S t]x (S R S^-1 R^-1) it holds for any R: the trace of the bracket is 3 up to
    second order in focal error times rotation. Normalising by t_z instead fails for sideways
    motion.
    """
    S_inverse = np.linalg.inv(S)
    M = S_inverse @ se3.hat(t) @ R @ S_inverse @ np.swapaxes(R, -1, -2)
    skew = (M - np.swapaxes(M, -1, -2)) / 2
    raw = np.stack([skew[..., 2, 1], skew[..., 0, 2], skew[..., 1, 0]], -1)
    return np.asarray(np.linalg.det(S)[..., None] * raw)


def rotation_error(t: Float, R: Float, S: Float) -> Float:
    """Rotation error Theta (..., 3) [rad] due to the focal error, first order in S - I (V-B).

    t: (..., 3), only its direction matters. R, S: (..., 3, 3). Theta is orthogonal to t, and zero
    for t = 0, where there is no epipolar constraint.
    """
    length = np.linalg.norm(t, axis=-1, keepdims=True)
    u = t / np.where(length > 0, length, 1.0)
    delta = S - _I
    turned = R @ delta @ np.swapaxes(R, -1, -2) - delta
    return np.asarray(np.cross(u, (turned @ u[..., None])[..., 0]))


def corrected_rotation(t: Float, R: Float, S: Float) -> Float:
    """Corrected rotation Rodrigues(Theta)^T R (..., 3, 3) from estimated t (..., 3) and R (V-B)."""
    return np.asarray(se3.so3_exp(-rotation_error(t, R, S)) @ R)
