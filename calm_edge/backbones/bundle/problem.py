"""Unknowns, measurements and residuals of the bundle adjustment, with their derivatives.

Unknowns: T_c_s of every view (the first is fixed), homogeneous points on the unit sphere in R^4 (so
that far points, which determine the rotation, stay well conditioned; Foerstner, "Minimal
Representations for Uncertainty and Estimation in Projective Spaces", ACCV 2010), and the kit
(kit/layout.py). Points are signed so that z > 0 where they are seen: noise may move a far one
through infinity (w < 0) and back without a barrier in the cost.
Every assistant pose is free but tied to the rig by a soft factor: the primary's pose is
interpolated at its exposure, so unsynchronised streams need no special case (paper IV-B, IV-C).
A rolling shutter exposes row by row: each observation is predicted at the instant of its row.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calm_edge.backbones.bundle.jitter import jitter
from calm_edge.geometry import se3
from calm_edge.kit import layout
from calm_edge.kit.lens import Lens
from calm_edge.types import Float, Int

# Smallest z of a unit homogeneous point that counts as in front of a view.
NEAREST = 1e-4


@dataclass(frozen=True, slots=True)
class Measurements:
    """Measurements of one window: O observations of M points in C views.

    view, point: (O,) indices, in order of the view. uv: (O, 2) px. sigma_px: (O,) one sigma of uv.
    edge: (O, 2) direction of an edge of the picture that an observation lies on, times the root of
    1 - sigma_px / its sigma along the edge; None if all are corners.
    eye: (C,) 0 or 1, primary views first. t: (C,) seconds. size: (2, 2) width, height
    of each eye's pictures.
    """

    view: Int
    point: Int
    uv: Float
    sigma_px: Float
    eye: Int
    t: Float
    size: Int
    edge: Float | None = None

    @property
    def n_views(self) -> int:
        return len(self.eye)

    def whitened(self, error: Float) -> Float:
        """Errors (..., 2, O) px, or derivatives of these, in sigmas."""
        out = error / self.sigma_px
        if self.edge is not None:
            along = np.ascontiguousarray(self.edge.T)
            out -= (along[0] * out[..., 0, :] + along[1] * out[..., 1, :])[..., None, :] * along
        return np.asarray(out)

    def at(self, rows: Int | np.ndarray[tuple[int], np.dtype[np.bool_]]) -> Measurements:
        """The observations in `rows`; indices of views and points stay."""
        edge = None if self.edge is None else self.edge[rows]
        return replace(
            self, view=self.view[rows], point=self.point[rows], uv=self.uv[rows],
            sigma_px=self.sigma_px[rows], edge=edge,
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class State:
    """Unknowns of a window, lengths in spacings.

    T_c_s: (C, 4, 4) sub-map to camera. points: (M, 4) homogeneous, of unit length, in the
    sub-map's frame. theta: (SIZE,) the kit (kit/layout.py).
    """

    T_c_s: Float
    points: Float
    theta: Float


@dataclass(frozen=True, slots=True)
class ReprojectionJacobians:
    """Predicted pixels (O, 2) of all observations and their derivatives; in_front: (O,) bool.

    camera: (6 + terms, 2, O), by the pose, then by the terms of layout.EYE. point: (3, 2, O) in
    the tangent of `tangent_basis`. Observations come last: sums over them are several times faster.
    """

    predicted: Float
    camera: Float
    point: Float
    in_front: np.ndarray[tuple[int], np.dtype[np.bool_]]


def tangent_basis(points: Float) -> Float:
    """Orthonormal bases (M, 4, 3) of the tangent spaces at unit vectors (M, 4)."""
    # Householder of the last axis: columns 0..2 of I - v v^T / (1 + |x_3|), sign for stability
    sign = np.where(points[:, 3] >= 0, 1.0, -1.0)
    v = points.copy()
    v[:, 3] += sign
    H = np.eye(4) - v[:, :, None] * v[:, None, :] / (1 + np.abs(points[:, 3]))[:, None, None]
    return np.ascontiguousarray(H[:, :, :3])


def move_points(points: Float, basis: Float, delta: Float) -> Float:
    """Move points (M, 4) by delta (M, 3) in their tangent spaces, and normalise them again."""
    moved = points + (basis @ delta[..., None])[..., 0]
    return np.asarray(moved / np.linalg.norm(moved, axis=1, keepdims=True))


@dataclass(frozen=True, slots=True)
class _Optics:
    """Optics for each observation: f (O,) px, centre (2, O) px; lenses: one of each eye.

    rows: slice of each eye's observations.
    """

    f: Float
    centre: Float
    lenses: tuple[Lens, Lens]
    rows: tuple[slice, slice]

    @classmethod
    def of(cls, theta: Float, m: Measurements) -> _Optics:
        eye = m.eye[m.view]
        f: Float = np.exp(theta[layout.LOG_FOCAL]) * m.size[:, 0]
        centre = (m.size - 1) / 2 + theta[layout.PRINCIPAL_POINT] * m.size[:, :1]
        first = int(np.searchsorted(eye, 1))
        rows = slice(0, first), slice(first, len(eye))
        return cls(f[eye], centre.T[:, eye], layout.lenses(theta), rows)

    def factor(self, s: Float) -> tuple[Float, Float]:
        """Image radius over that of a pinhole camera at squared radii s (O,); derivative by s."""
        parts = [lens.factor(s[rows]) for lens, rows in zip(self.lenses, self.rows, strict=True)]
        return np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts])

    def terms(self, s: Float) -> Float:
        """Derivatives (terms, O) of the factor by the lens terms."""
        parts = [lens.terms(s[rows]) for lens, rows in zip(self.lenses, self.rows, strict=True)]
        return np.concatenate(parts, 1)


def camera_points(state: State, m: Measurements) -> Float:
    """Each observation's point (3, O) in the axes of its view.

    Up to a scale: a homogeneous point of unit length, without its fourth coordinate.
    """
    n_points, n_views = len(state.points), m.n_views
    # product of all views and all points: faster than selecting the few observed pairs
    every = state.points @ state.T_c_s[:, :3].reshape(-1, 4).T
    return np.ascontiguousarray(every.reshape(n_points, n_views, 3)[m.point, m.view].T)


def view_rates(T_c_s: Float, m: Measurements) -> Float:
    """Twists per second (C, 6) of the views: the derivative of T_c_s by time is hat(twist) T_c_s.

    Of a parabola through each view and its neighbours of the same eye; zero for an eye's only view.
    """
    out = np.zeros((m.n_views, 6))
    for eye in (0, 1):
        (views,) = np.nonzero(m.eye == eye)
        if len(views) < 2:
            continue
        dt = np.diff(m.t[views])
        rate = se3.log(T_c_s[views[1:]] @ se3.inverse(T_c_s[views[:-1]])) / dt[:, None]
        # change of the rate by half of two intervals, at each view between these
        bend = np.diff(rate, axis=0) / (dt[:-1] + dt[1:])[:, None]
        out[views[:-1]] = rate
        out[views[1:-1]] = rate[:-1] + dt[:-1, None] * bend
        out[views[-1]] = rate[-1]
        if len(bend):
            out[views[0]] -= dt[0] * bend[0]
            out[views[-1]] += dt[-1] * bend[-1]
    return out


def exposed_points(state: State, m: Measurements) -> tuple[Float, Float]:
    """`camera_points` (3, O) at the exposure of the rows; and their derivative by readout time.

    To first order in the readout time. That the twists depend on the poses is neglected in the
    derivatives by these: it is a share of readout time over time between keyframes.
    """
    p_c = camera_points(state, m)
    (x, y, z), w = p_c, state.points[:, 3][m.point]
    u, v, n, a, b, c = view_rates(state.T_c_s, m).T[:, m.view]
    eye = m.eye[m.view]
    motion = np.stack([u * w + b * z - c * y, v * w + c * x - a * z, n * w + a * y - b * x])
    motion *= m.uv[:, 1] / (m.size[eye, 1] - 1) - 0.5
    return p_c + state.theta[layout.READOUT][eye] * motion, motion


def project(state: State, m: Measurements) -> tuple[Float, Float]:
    """Predicted pixels (O, 2), and z (O,) of `exposed_points`."""
    (X, Y, Z), _ = exposed_points(state, m)
    lens, z = _Optics.of(state.theta, m), _away_from_zero(Z)
    x, y = X / z, Y / z
    gain = lens.f * lens.factor(x * x + y * y)[0]
    return (np.stack([gain * x, gain * y]) + lens.centre).T, Z


def _away_from_zero(z: Float) -> Float:
    return np.where(np.abs(z) < NEAREST, NEAREST, z)


def reprojection(state: State, m: Measurements, basis: Float) -> ReprojectionJacobians:
    """Pixels and analytic derivatives of all observations."""
    (X, Y, Z), motion = exposed_points(state, m)
    lens, z = _Optics.of(state.theta, m), _away_from_zero(Z)
    x, y = q = np.stack([X / z, Y / z])
    square = x * x + y * y
    gain, slope = lens.factor(square)
    offset = lens.f * gain * q
    by_point = np.empty((3, 2, len(z)))
    by_point[0, 0], by_point[1, 1] = gain + 2 * slope * x * x, gain + 2 * slope * y * y
    by_point[0, 1] = by_point[1, 0] = 2 * slope * x * y
    by_point[:2] *= lens.f / z
    by_point[2] = -q[0] * by_point[0] - q[1] * by_point[1]
    camera = np.zeros((6 + layout.EYE.shape[1], 2, len(z)))
    camera[:3] = by_point * state.points[:, 3][m.point]
    camera[3] = Y * by_point[2] - Z * by_point[1]
    camera[4] = Z * by_point[0] - X * by_point[2]
    camera[5] = X * by_point[1] - Y * by_point[0]
    of_eye, (cx, cy) = camera[6:], layout.PRINCIPAL_POINT[0]
    of_eye[layout.LOG_FOCAL[0]] = offset
    of_eye[cx, 0] = of_eye[cy, 1] = m.size[:, 0][m.eye[m.view]]
    of_eye[layout.DISTORTION[0]] = lens.terms(square)[:, None] * (lens.f * q)
    of_eye[layout.READOUT[0]] = (by_point * motion[:, None]).sum(0)
    point = times(times(by_point, state.T_c_s[:, :3], m.view), basis, m.point)
    return ReprojectionJacobians((offset + lens.centre).T, camera, point, Z > NEAREST)


def times(rows: Float, matrices: Float, index: Int) -> Float:
    """Multiply Jacobians (I, 2, O) of O observations, each by its matrix (I, J): (J, 2, O).

    matrices: (N, I, J). index: (O,) which of these each observation takes.
    """
    chosen = np.ascontiguousarray(matrices.transpose(1, 2, 0)).take(index, axis=2)
    return np.asarray(np.einsum("iko,ijo->jko", rows, chosen))


@dataclass(frozen=True, slots=True)
class RigTies:
    """Ties: soft constraints of each assistant view to the rig at the interpolated primary pose.

    assistant, before, after: (A,) view indices. alpha: (A,) position of the exposure between the
    primary views before (0) and after (1). rate: (A,) change of alpha per second.
    information_root: (A, 6) one over sigma of (translation [spacings], rotation [rad]). jitter_s:
    (A,) delay of the assistant's stamp against constant frame rates of both cameras; empty if there
    are none. late_s: (A,) part of the jitter for which alpha is corrected. along: (A, 6) direction
    in whitened residuals in which a tie is softened, because its instant is uncertain; 0 for none.
    """

    assistant: Int
    before: Int
    after: Int
    alpha: Float
    rate: Float
    information_root: Float
    jitter_s: Float
    late_s: Float
    along: Float

    def whitened(self, residual: Float) -> Float:
        """Residuals (..., A, 6) in sigmas."""
        out = residual * self.information_root
        if self.along.any():
            out -= self.along * (out * self.along).sum(-1, keepdims=True)
        return np.asarray(out)


# Sigma of a tie at simultaneous exposures (TIE_*). Between two primary exposures the error of
# interpolation at constant velocity is added, for accelerations with these sigmas.
TIE_TRANSLATION_SIGMA = 2e-3  # spacings
TIE_ROTATION_SIGMA_RAD = 1e-4
ACCELERATION = 3.0  # spacings / s^2
ANGULAR_ACCELERATION = 0.3  # rad / s^2


def rig_ties(m: Measurements) -> RigTies:
    """Create the ties of all assistant views, each to the primary views before and after it."""
    primary, assistant = np.flatnonzero(m.eye == 0), np.flatnonzero(m.eye == 1)
    t = m.t[primary]
    i = np.clip(np.searchsorted(t, m.t[assistant], side="right") - 1, 0, len(t) - 2)
    gap = t[i + 1] - t[i]
    alpha = (m.t[assistant] - t[i]) / gap
    # remainder of linear interpolation: alpha (1 - alpha) / 2 dt^2 times the acceleration
    bend = np.abs(alpha * (1 - alpha)) / 2 * gap**2
    root = np.empty((len(assistant), 6))
    root[:, :3] = 1 / np.hypot(TIE_TRANSLATION_SIGMA, ACCELERATION * bend)[:, None]
    root[:, 3:] = 1 / np.hypot(TIE_ROTATION_SIGMA_RAD, ANGULAR_ACCELERATION * bend)[:, None]
    off_p, off_a = jitter(t), jitter(m.t[assistant])
    off = np.zeros(0)
    if off_p is not None and off_a is not None:
        off = off_a - (1 - alpha) * off_p[i] - alpha * off_p[i + 1]
    still = np.zeros_like(alpha)
    along = np.zeros_like(root)
    return RigTies(assistant, primary[i], primary[i + 1], alpha, 1 / gap, root, off, still, along)


def tie_errors(
    T_before: Float, T_after: Float, T_assistant: Float, rig: Float, late_s: float, ties: RigTies
) -> Float:
    """Errors (..., A, 6) of the ties: log of T_p_a^-1 T_p(t_a) T_a^-1, with poses T_c_s.

    T_before, T_after, T_assistant: (..., A, 4, 4); T_p is interpolated between the first two.
    late_s: the kit's time offset.
    """
    # the primary moves along the geodesic: T_p(t)_s = exp(alpha log(T_1 T_0^-1)) T_0
    step = se3.log(T_after @ se3.inverse(T_before))
    share = ties.alpha + ties.rate * late_s
    T_p_s = se3.exp(share[:, None] * step) @ T_before
    error = T_p_s @ se3.inverse(T_assistant)  # the rig T_p_a implied by the poses
    return np.asarray(se3.log(se3.inverse(rig) @ error))


def tie_residuals(
    T_before: Float, T_after: Float, T_assistant: Float, rig: Float, late_s: float, ties: RigTies
) -> Float:
    """Whitened residuals (..., A, 6) of the ties: `tie_errors` in sigmas."""
    return ties.whitened(tie_errors(T_before, T_after, T_assistant, rig, late_s, ties))


def tie_jacobians(state: State, ties: RigTies) -> tuple[Float, Float]:
    """Residuals (A, 6) and derivatives (A, 6, 25) by (before, after, assistant, rig, time offset).

    With xi the twist from T_before to T_after and `share` the part of it at the exposure, the
    primary's pose then is P = exp(share xi) T_before. The error, log of T_p_a^-1 P T_assistant^-1,
    is differentiated by the chain rule over P. Jacobians of SE(3) as in Barfoot, "State Estimation
    for Robotics", 2017, section 7.1.
    """
    rig, late = layout.rig(state.theta), float(state.theta[layout.TIME_OFFSET])
    T_before, T_after, T_assistant = (
        state.T_c_s[v] for v in (ties.before, ties.after, ties.assistant)
    )
    error = tie_errors(T_before, T_after, T_assistant, rig, late, ties)
    inverse_right = se3.right_jacobian_inverse(error)
    xi = se3.log(T_after @ se3.inverse(T_before))
    share = (ties.alpha + ties.rate * late)[:, None]
    part = share * xi
    # the left Jacobian at xi is the right Jacobian at -xi
    spread = np.linalg.solve(se3.right_jacobian_inverse(-part), share[..., None] * np.eye(6))
    by_after = spread @ se3.right_jacobian_inverse(-xi)
    by_before = se3.adjoint(se3.exp(part)) - spread @ se3.right_jacobian_inverse(xi)
    T_a_p = T_assistant @ se3.inverse(se3.exp(part) @ T_before)
    by_primary = inverse_right @ se3.adjoint(T_a_p)
    J = np.empty((len(ties.alpha), 6, 25))
    J[..., :6], J[..., 6:12] = by_primary @ by_before, by_primary @ by_after
    J[..., 12:18] = -inverse_right
    # the rig is stepped by adding to its rotation vector and centre
    turn = state.theta[layout.RIG_ROTATION]
    step = np.zeros((6, 6))
    step[:3, 3:], step[3:, :3] = rig[:3, :3].T, se3.so3_left_jacobian(-turn)
    J[..., 18:24] = -se3.right_jacobian_inverse(-error) @ step
    J[..., 24] = (by_primary @ (ties.rate[:, None] * xi)[..., None])[..., 0]
    by_step = ties.whitened(np.moveaxis(J, 2, 0))
    return ties.whitened(error), np.moveaxis(by_step, 0, 2)
