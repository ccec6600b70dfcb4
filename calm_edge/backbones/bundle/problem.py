"""The bundle adjustment's unknowns, measurements and residuals, with their derivatives.

Unknowns: T_c_s of every view (the first is held), homogeneous points on the unit sphere in R^4
(so that far points, which carry the rotation, stay well conditioned), and the kit (kit.py).
Points are signed so that z > 0 where they are seen: noise may then push a far one through
infinity (w < 0) and back without a wall in the cost.
Every assistant pose is free but tied to the rig by a soft factor: at its own instant the primary
is interpolated, so unsynchronised streams need no special case (paper IV-B, IV-C).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calm_edge.backbones.bundle import kit
from calm_edge.geometry import se3
from calm_edge.types import Float, Int

# z of a unit homogeneous point, below which it is not in front of a view: its pixel would be wild
NEAREST = 1e-4


@dataclass(frozen=True, slots=True)
class Measurements:
    """What is measured in one window; O observations of M points in C views.

    view, point: (O,) indices. uv: (O, 2) px. sigma_px: (O,) one sigma of uv.
    eye: (C,) 0 or 1, primary views first. t: (C,) seconds. size: (2, 2) width, height an eye.
    """

    view: Int
    point: Int
    uv: Float
    sigma_px: Float
    eye: Int
    t: Float
    size: Int

    @property
    def n_views(self) -> int:
        return len(self.eye)


@dataclass(frozen=True, slots=True)
class State:
    """T_c_s: (C, 4, 4) spacings. points: (M, 4) unit homogeneous, sub-map frame. theta: (15,)."""

    T_c_s: Float
    points: Float
    theta: Float


@dataclass(frozen=True, slots=True)
class ReprojectionJacobians:
    """Of the projected pixel of each observation. predicted: (O, 2); in_front: (O,) bool.

    pose: (O, 2, 6), optics: (O, 2, 4), point: (O, 2, 3) in the tangent of `tangent_basis`.
    """

    predicted: Float
    pose: Float
    optics: Float
    point: Float
    in_front: np.ndarray[tuple[int], np.dtype[np.bool_]]


def tangent_basis(points: Float) -> Float:
    """(M, 4) unit vectors -> (M, 4, 3) orthonormal bases of their tangent spaces."""
    # Householder of the last axis: columns 0..2 of I - v v^T / (1 + |x_3|), sign for stability
    sign = np.where(points[:, 3] >= 0, 1.0, -1.0)
    v = points.copy()
    v[:, 3] += sign
    H = np.eye(4) - v[:, :, None] * v[:, None, :] / (1 + np.abs(points[:, 3]))[:, None, None]
    return np.ascontiguousarray(H[:, :, :3])


def move_points(points: Float, basis: Float, delta: Float) -> Float:
    """Points (M, 4) stepped by delta (M, 3) in their tangents, back onto the sphere."""
    moved = points + (basis @ delta[..., None])[..., 0]
    return np.asarray(moved / np.linalg.norm(moved, axis=1, keepdims=True))


def project(state: State, m: Measurements) -> tuple[Float, Float]:
    """Predicted pixels (O, 2) and camera points (O, 3) of the observations."""
    T = state.T_c_s[m.view]
    q = (T[:, :3] @ state.points[m.point][..., None])[..., 0]
    optics = state.theta[:8].reshape(2, 4)[m.eye[m.view]]
    size = m.size[m.eye[m.view]].astype(np.float64)
    z = np.where(np.abs(q[:, 2]) < NEAREST, NEAREST, q[:, 2])
    xy = q[:, :2] / z[:, None]
    radial = 1 + optics[:, 3] * (xy * xy).sum(1)
    f = np.exp(optics[:, 0]) * size[:, 0]
    centre = (size - 1) / 2 + optics[:, 1:3] * size[:, :1]
    return f[:, None] * radial[:, None] * xy + centre, q


def reprojection(state: State, m: Measurements, basis: Float) -> ReprojectionJacobians:
    """Pixels and analytic derivatives of all observations."""
    predicted, q = project(state, m)
    eye = m.eye[m.view]
    optics = state.theta[:8].reshape(2, 4)[eye]
    width = m.size[eye, 0].astype(np.float64)
    f = np.exp(optics[:, 0]) * width
    z = np.where(np.abs(q[:, 2]) < NEAREST, NEAREST, q[:, 2])
    x, y = q[:, 0] / z, q[:, 1] / z
    r2, k1 = x * x + y * y, optics[:, 3]
    radial = 1 + k1 * r2
    n = len(f)
    d_xy = np.empty((n, 2, 2))  # pixel by normalised point
    d_xy[:, 0, 0] = f * (radial + 2 * k1 * x * x)
    d_xy[:, 1, 1] = f * (radial + 2 * k1 * y * y)
    d_xy[:, 0, 1] = d_xy[:, 1, 0] = f * 2 * k1 * x * y
    d_q = np.zeros((n, 2, 3))
    d_q[:, 0, 0] = d_q[:, 1, 1] = 1 / z
    d_q[:, 0, 2], d_q[:, 1, 2] = -x / z, -y / z
    d_q = d_xy @ d_q
    w = state.points[m.point, 3]
    pose = np.empty((n, 2, 6))
    pose[:, :, :3] = d_q * w[:, None, None]
    pose[:, :, 3:] = -d_q @ se3.hat(q)
    d_optics = np.zeros((n, 2, 4))
    d_optics[:, 0, 0], d_optics[:, 1, 0] = f * radial * x, f * radial * y
    d_optics[:, 0, 1] = d_optics[:, 1, 2] = width
    d_optics[:, 0, 3], d_optics[:, 1, 3] = f * r2 * x, f * r2 * y
    point = d_q @ (state.T_c_s[m.view][:, :3] @ basis[m.point])
    return ReprojectionJacobians(predicted, pose, d_optics, point, q[:, 2] > NEAREST)


@dataclass(frozen=True, slots=True)
class RigTies:
    """Where each assistant view sits between two primary views, and how stiff its tie is.

    assistant, before, after: (A,) view indices. alpha: (A,) share of the way from before to after
    as the stamps say it. rate: (A,) that share a second. information_root: (A, 6) one over sigma
    of (translation [spacings], rotation [rad]).
    """

    assistant: Int
    before: Int
    after: Int
    alpha: Float
    rate: Float
    information_root: Float


# A car's body between two instants: what constant velocity misses grows with their distance.
TIE_TRANSLATION_SIGMA = 2e-3  # spacings, when the instants coincide
TIE_ROTATION_SIGMA_RAD = 1e-4
ACCELERATION = 3.0  # spacings / s^2
ANGULAR_ACCELERATION = 0.3  # rad / s^2


def rig_ties(m: Measurements) -> RigTies:
    """Ties of the assistant views to the primary views around their instants."""
    primary, assistant = np.flatnonzero(m.eye == 0), np.flatnonzero(m.eye == 1)
    t = m.t[primary]
    i = np.clip(np.searchsorted(t, m.t[assistant], side="right") - 1, 0, len(t) - 2)
    gap = t[i + 1] - t[i]
    alpha = (m.t[assistant] - t[i]) / gap
    # the classical interpolation remainder, alpha (1 - alpha) / 2 dt^2 times the acceleration
    bend = np.abs(alpha * (1 - alpha)) / 2 * gap**2
    root = np.empty((len(assistant), 6))
    root[:, :3] = 1 / np.hypot(TIE_TRANSLATION_SIGMA, ACCELERATION * bend)[:, None]
    root[:, 3:] = 1 / np.hypot(TIE_ROTATION_SIGMA_RAD, ANGULAR_ACCELERATION * bend)[:, None]
    return RigTies(assistant, primary[i], primary[i + 1], alpha, 1 / gap, root)


def tie_residuals(
    T_before: Float, T_after: Float, T_assistant: Float, rig: Float, late_s: float, ties: RigTies
) -> Float:
    """(..., A, 6) whitened log of (T_p(t_a) T_p_a)^-1 T_a; poses are T_c_s (..., A, 4, 4).

    late_s: how much later than its stamp an assistant's picture was exposed.
    """
    # between them the primary moves along the geodesic: T_p(t)_s = exp(alpha log(T_1 T_0^-1)) T_0
    step = se3.log(T_after @ se3.inverse(T_before))
    share = ties.alpha + ties.rate * late_s
    T_p_s = se3.exp(share[:, None] * step) @ T_before
    error = T_p_s @ se3.inverse(T_assistant)  # T_p_a as the poses have it
    return np.asarray(se3.log(se3.inverse(rig) @ error) * ties.information_root)


def tie_jacobians(state: State, ties: RigTies) -> tuple[Float, Float]:
    """Residuals (A, 6) and derivatives (A, 6, 25) by (before, after, assistant, rig, lateness).

    Numerical: one call on the stack of all steps of fifteen ties costs less than analysis would
    read.
    """
    h = 1e-6
    # (4 blocks, 6 axes, 2 signs): row [b, k, s] steps axis k of block b
    step = np.zeros((4, 6, 2, 4, 6))
    for block in range(4):
        for k in range(6):
            step[block, k, :, block, k] = h, -h
    move = se3.exp(step[..., :3, :])[..., None, :, :]  # (4, 6, 2, 3, 1, 4, 4)
    views = (ties.before, ties.after, ties.assistant)
    before, after, assistant = (move[..., i, :, :, :] @ state.T_c_s[v] for i, v in enumerate(views))
    rig_part = state.theta[kit.RIG] + step[..., 3, :]
    rig = se3.compose(se3.so3_exp(rig_part[..., :3]), rig_part[..., 3:])[..., None, :, :]
    late = float(state.theta[kit.LATE])
    sides = tie_residuals(before, after, assistant, rig, late, ties)  # (4, 6, 2, A, 6)
    J = (sides[:, :, 0] - sides[:, :, 1]) / (2 * h)
    J = J.transpose(2, 3, 0, 1).reshape(len(ties.alpha), 6, 24)
    rig_here = kit.rig(state.theta)

    def at(late_s: float) -> Float:
        T_before, T_after, T_assistant = (state.T_c_s[v] for v in views)
        return tie_residuals(T_before, T_after, T_assistant, rig_here, late_s, ties)

    J_late = (at(late + h) - at(late - h))[..., None] / (2 * h)
    return at(late), np.concatenate([J, J_late], 2)
