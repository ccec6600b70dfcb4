"""SE(3) and SO(3): exponential, logarithm, Jacobians, interpolation and mean, vectorised.

Poses are stacks (..., 4, 4), twists (..., 6) = (translation, rotation). Formulas as in Barfoot,
"State Estimation for Robotics", 2017, chapter 7.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]

# Twice the cosine of a rotation angle, 120 degrees, from which on its logarithm is taken otherwise.
LARGE_ANGLE = -1.0


def hat(v: Float) -> Float:
    """Cross-product matrices (..., 3, 3) of vectors (..., 3)."""
    v = np.asarray(v, np.float64)
    out = np.zeros((*v.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = v[..., 2], -v[..., 1], v[..., 0]
    return out


def so3_exp(w: Float) -> Float:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3) [rad] (Rodrigues' formula)."""
    w = np.asarray(w, np.float64)
    theta2 = (w * w).sum(-1)[..., None, None]
    theta = np.sqrt(theta2)
    small = theta2 < 1e-12
    safe = np.where(small, 1.0, theta)
    a = np.where(small, 1 - theta2 / 6, np.sin(safe) / safe)
    b = np.where(small, 0.5 - theta2 / 24, (1 - np.cos(safe)) / safe**2)
    W = hat(w)
    return np.asarray(np.eye(3) + a * W + b * (W @ W))


def so3_log(R: Float) -> Float:
    """Rotation vectors (..., 3) [rad] of matrices (..., 3, 3); accurate up to and including pi."""
    R = np.asarray(R, np.float64)
    # 2 sin(angle) times the axis, and 2 cos(angle)
    w = R[..., [2, 0, 1], [1, 2, 0]] - R[..., [1, 2, 0], [2, 0, 1]]
    cosine = R[..., 0, 0] + R[..., 1, 1] + R[..., 2, 2] - 1.0
    if (cosine < LARGE_ANGLE).any():
        return _so3_log_of_large(R)
    sine = np.sqrt((w * w).sum(-1))
    small = sine < 1e-9
    factor = np.where(small, 0.5, np.arctan2(sine, cosine) / np.where(small, 1.0, sine))
    return np.asarray(factor[..., None] * w)


def _so3_log_of_large(R: Float) -> Float:
    """As `so3_log`, also near pi, where the axis is lost in the antisymmetric part."""
    # via the quaternion, computed from its largest component: stable at 0 and at pi
    m = R
    t = np.stack(
        [
            1 + m[..., 0, 0] + m[..., 1, 1] + m[..., 2, 2],
            1 + m[..., 0, 0] - m[..., 1, 1] - m[..., 2, 2],
            1 - m[..., 0, 0] + m[..., 1, 1] - m[..., 2, 2],
            1 - m[..., 0, 0] - m[..., 1, 1] + m[..., 2, 2],
        ],
        -1,
    )
    a = m[..., 2, 1] - m[..., 1, 2]
    b = m[..., 0, 2] - m[..., 2, 0]
    c = m[..., 1, 0] - m[..., 0, 1]
    d = m[..., 1, 0] + m[..., 0, 1]
    e = m[..., 0, 2] + m[..., 2, 0]
    f = m[..., 2, 1] + m[..., 1, 2]
    rows = np.stack(
        [
            np.stack([t[..., 0], a, b, c], -1),
            np.stack([a, t[..., 1], d, e], -1),
            np.stack([b, d, t[..., 2], f], -1),
            np.stack([c, e, f, t[..., 3]], -1),
        ],
        -2,
    )
    best = np.argmax(t, -1)
    q = np.take_along_axis(rows, best[..., None, None], -2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    q = np.where(q[..., :1] < 0, -q, q)
    s = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(s, q[..., :1])
    factor = np.where(s < 1e-9, 2.0, angle / np.where(s < 1e-9, 1.0, s))
    return np.asarray(q[..., 1:] * factor)


def quaternions(R: Float) -> Float:
    """Convert rotations (..., 3, 3) to unit quaternions (..., 4) in order x y z w, w >= 0."""
    half = so3_log(R) / 2
    angle = np.linalg.norm(half, axis=-1, keepdims=True)
    # sinc is finite at an angle of zero
    return np.concatenate([half * np.sinc(angle / np.pi), np.cos(angle)], -1)


def rotations(q: Float) -> Float:
    """Convert unit quaternions (..., 4) in order x y z w to rotations (..., 3, 3)."""
    v, w = q[..., :3], q[..., 3:, None]
    V = hat(v)
    return np.asarray(np.eye(3) + 2 * w * V + 2 * V @ V)


def compose(R: Float, t: Float) -> Float:
    """Poses (..., 4, 4) from rotations (..., 3, 3) and translations (..., 3)."""
    R, t = np.asarray(R, np.float64), np.asarray(t, np.float64)
    shape = np.broadcast_shapes(R.shape[:-2], t.shape[:-1])
    T = np.zeros((*shape, 4, 4))
    T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = R, t, 1.0
    return T


def inverse(T: Float) -> Float:
    """Inverse of rigid poses (..., 4, 4)."""
    Rt = np.swapaxes(T[..., :3, :3], -1, -2)
    return compose(Rt, -(Rt @ T[..., :3, 3, None])[..., 0])


def so3_left_jacobian(w: Float) -> Float:
    """Left Jacobian of SO(3) (..., 3, 3) at w (..., 3): exp(w + d) = exp(J d) exp(w) + O(d^2)."""
    theta2 = (w * w).sum(-1)[..., None, None]
    theta = np.sqrt(theta2)
    small = theta2 < 1e-10
    safe = np.where(small, 1.0, theta)
    b = np.where(small, 0.5 - theta2 / 24, (1 - np.cos(safe)) / safe**2)
    c = np.where(small, 1 / 6 - theta2 / 120, (safe - np.sin(safe)) / safe**3)
    W = hat(w)
    return np.asarray(np.eye(3) + b * W + c * (W @ W))


def exp(xi: Float) -> Float:
    """Exponential map of SE(3): poses (..., 4, 4) of twists (..., 6)."""
    xi = np.asarray(xi, np.float64)
    rho, w = xi[..., :3], xi[..., 3:]
    return compose(so3_exp(w), (so3_left_jacobian(w) @ rho[..., None])[..., 0])


def log(T: Float) -> Float:
    """Logarithm of SE(3): twists (..., 6) of poses (..., 4, 4)."""
    w, t = so3_log(T[..., :3, :3]), T[..., :3, 3, None]
    theta2 = (w * w).sum(-1)[..., None, None]
    small = theta2 < 1e-4
    half = np.sqrt(np.where(small, 1.0, theta2)) / 2
    # the inverse of the left Jacobian of SO(3) is I - W / 2 + c W^2
    c = np.where(small, 1 / 12 + theta2 / 720, (1 - half / np.tan(half)) / (4 * half**2))
    W = hat(w)
    across = W @ t
    return np.concatenate([(t - across / 2 + c * (W @ across))[..., 0], w], -1)


def interpolate(T_0: Float, T_1: Float, alpha: Float | float) -> Float:
    """Interpolate poses (..., 4, 4) on the SE(3) geodesic from T_0 (alpha 0) to T_1 (alpha 1).

    alpha: (...), outside [0, 1] it extrapolates. Paper IV-B: the reference pose T_ref of an
    assistant frame between two primary frames.
    """
    xi = log(inverse(T_0) @ T_1)
    return np.asarray(T_0 @ exp(xi * np.asarray(alpha, np.float64)[..., None]))


def interpolate_at(t: Float, T: Float, query: Float) -> Float:
    """Interpolate a trajectory T (N, 4, 4) at sorted times t (N,), N >= 2, to `query` (M,).

    Beyond either end, extrapolates with the velocity of the nearest segment.
    """
    t, query = np.asarray(t, np.float64), np.asarray(query, np.float64)
    i = np.clip(np.searchsorted(t, query, side="right") - 1, 0, len(t) - 2)
    alpha = (query - t[i]) / (t[i + 1] - t[i])
    return interpolate(T[i], T[i + 1], alpha)


def transform(T: Float, p: Float) -> Float:
    """Transform points p (..., 3) by T (4, 4)."""
    return np.asarray(p @ T[:3, :3].T + T[:3, 3])


def adjoint(T: Float) -> Float:
    """Adjoint (..., 6, 6) of poses (..., 4, 4) for twists (translation, rotation)."""
    A = np.zeros((*T.shape[:-2], 6, 6))
    A[..., :3, :3] = A[..., 3:, 3:] = T[..., :3, :3]
    A[..., :3, 3:] = hat(T[..., :3, 3]) @ T[..., :3, :3]
    return A


def right_jacobian_inverse(xi: Float) -> Float:
    """Inverse right Jacobian of SE(3) (..., 6, 6): log(exp(xi) exp(d)) = xi + J d + O(d^2).

    xi: (..., 6), rotation below 2 pi. J = I + ad/2 + a ad^2 + b ad^4, with ad the matrix of the Lie
    bracket with xi and theta its angle: the Bernoulli series reduced by the characteristic
    polynomial ad^5 + 2 theta^2 ad^3 + theta^4 ad = 0; a and b are from (theta/2) cot(theta/2) and
    its derivative.
    """
    ad = np.zeros((*xi.shape[:-1], 6, 6))
    ad[..., :3, :3] = ad[..., 3:, 3:] = hat(xi[..., 3:])
    ad[..., :3, 3:] = hat(xi[..., :3])
    theta2 = (xi[..., 3:] ** 2).sum(-1)
    small = theta2 < 1e-3
    theta = np.sqrt(np.where(small, 1.0, theta2))
    half_cot = 0.5 / np.tan(theta / 2)
    missing = 1 - theta * half_cot
    slope = theta * half_cot - (theta / 2 / np.sin(theta / 2)) ** 2
    quartic = slope / 2 + missing
    a = np.where(small, 1 / 12 - theta2**2 / 30240, (missing + quartic) / theta**2)
    b = np.where(small, -1 / 720 - theta2 / 15120, quartic / theta**4)
    ad2 = ad @ ad
    return np.asarray(
        np.eye(6) + ad / 2 + a[..., None, None] * ad2 + b[..., None, None] * (ad2 @ ad2)
    )


def mean(T: Float, iterations: int = 20) -> Float:
    """Mean (..., 4, 4) of poses (..., N, 4, 4) on the manifold: the twists to it average to 0."""
    average = np.asarray(T[..., 0, :, :], np.float64)
    for _ in range(iterations):
        step = log(inverse(average)[..., None, :, :] @ T).mean(-2)
        average = average @ exp(step)
        # relative to the distance from the origin, to which rounding errors are proportional
        if (np.abs(step).max(-1) < 1e-14 * (1 + np.abs(average[..., :3, 3]).max(-1))).all():
            break
    return average
