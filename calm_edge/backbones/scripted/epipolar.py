"""Two views from their matches under any K: pairs solved at once, and lengths between pairs.

Rays are pixels divided by K, (x, y, 1); p_b = R p_a + t, and x_b^T E x_a = 0 with E = [t]x R.
"""

from __future__ import annotations

import numpy as np

from calm_edge.geometry import se3
from calm_edge.types import Float

_ITERATIONS = 40
_CONVERGED = 1e-12
_AXES = se3.hat(np.eye(3))


def essential(T_b_a: Float) -> Float:
    """E (..., 3, 3) of relative poses (..., 4, 4)."""
    return np.asarray(se3.hat(T_b_a[..., :3, 3]) @ T_b_a[..., :3, :3])


def sampson(E: Float, x_a: Float, x_b: Float, f_a: Float, f_b: Float) -> Float:
    """Signed Sampson distances (P, C) [px] of matches (P, C, 3) to E (P, 3, 3).

    f_a, f_b: (P, 2) focals that the rays were made with, px.
    """
    return _residuals(E[:, None], x_a, x_b, f_a, f_b)[0]


def solve(T_b_a: Float, x_a: Float, x_b: Float, f_a: Float, f_b: Float, weight: Float) -> Float:
    """The relative poses (P, 4, 4) that minimise sum weight * sampson^2; translations of length 1.

    T_b_a: (P, 4, 4) starts. weight: (P, C), 0 leaves a match out. Levenberg-Marquardt over three
    rotations and two directions of the translation, each pair on its own.
    """
    T = np.array(T_b_a)
    T[:, :3, 3] /= np.linalg.norm(T[:, :3, 3], axis=1, keepdims=True)
    damping = np.full(len(T), 1e-4)
    r, J, tangent = _linearised(T, x_a, x_b, f_a, f_b)
    cost = (weight * r**2).sum(1)
    going = np.ones(len(T), bool)
    for _ in range(_ITERATIONS):
        A = np.einsum("pic,pjc,pc->pij", J, J, weight, optimize=True)
        y = np.einsum("pic,pc->pi", J, weight * r)
        diagonal = np.einsum("pii->pi", A)
        A = A + np.einsum("p,pi,ij->pij", damping, diagonal + 1e-12, np.eye(5))
        step = -np.linalg.solve(A, y[..., None])[..., 0]
        trial = _moved(T, step, tangent)
        r_new, J_new, tangent_new = _linearised(trial, x_a, x_b, f_a, f_b)
        cost_new = (weight * r_new**2).sum(1)
        better = going & (cost_new < cost)
        T[better], r[better], J[better] = trial[better], r_new[better], J_new[better]
        tangent[better] = tangent_new[better]
        small = cost - cost_new <= _CONVERGED * cost
        damping = np.where(better, damping / 5, damping * 8)
        cost = np.where(better, cost_new, cost)
        going &= ~((better & small) | (damping > 1e6))
        if not going.any():
            break
    return T


def inverse_depth(T_b_a: Float, x_a: Float, x_b: Float) -> tuple[Float, Float]:
    """1 / z (..., C) in view a of matches (..., C, 3), and its information (..., C).

    Linear in 1 / z: x_b x (R x_a + t / z) = 0. Sums of both over several b are the
    least-squares answer: sum(information * value) / sum(information). T_b_a: (..., 4, 4).
    """
    turned = x_a @ np.swapaxes(T_b_a[..., :3, :3], -1, -2)
    across = np.cross(x_b, T_b_a[..., None, :3, 3])
    information = (across**2).sum(-1)
    value = -(np.cross(x_b, turned) * across).sum(-1)
    return value / np.maximum(information, 1e-18), information


def weighted_median(value: Float, weight: Float) -> Float:
    """(P,) of rows (P, C); weights >= 0 with a positive sum."""
    order = np.argsort(value, axis=1)
    value = np.take_along_axis(value, order, 1)
    share = np.cumsum(np.take_along_axis(weight, order, 1), axis=1)
    middle = (share < share[:, -1:] / 2).sum(1)
    return np.asarray(value[np.arange(len(value)), middle])


def _residuals(E: Float, x_a: Float, x_b: Float, f_a: Float, f_b: Float) -> tuple[Float, Float]:
    """Sampson distances (P, C) of E[:, 0], and their slopes (P, k, C) along E[:, 1:]."""
    in_b = E @ np.swapaxes(x_a, 1, 2)[:, None]
    in_a = np.swapaxes(E, -1, -2) @ np.swapaxes(x_b, 1, 2)[:, None]
    value = np.einsum("pkic,pci->pkc", in_b, x_b)
    g_b, g_a = in_b[:, :, :2] / f_b[:, None, :, None], in_a[:, :, :2] / f_a[:, None, :, None]
    norm2 = (g_b[:, 0] ** 2).sum(1) + (g_a[:, 0] ** 2).sum(1) + 1e-30
    norm = np.sqrt(norm2)
    r = value[:, 0] / norm
    half_slope = (g_b[:, 1:] * g_b[:, :1]).sum(2) + (g_a[:, 1:] * g_a[:, :1]).sum(2)
    slope = value[:, 1:] / norm[:, None] - r[:, None] * half_slope / norm2[:, None]
    return r, slope


def _linearised(
    T: Float, x_a: Float, x_b: Float, f_a: Float, f_b: Float
) -> tuple[Float, Float, Float]:
    """Residuals (P, C), their Jacobian (P, 5, C) and the tangent basis (P, 2, 3) it refers to."""
    R, t = T[:, :3, :3], T[:, :3, 3]
    tangent = _tangent(t)
    E = se3.hat(t) @ R
    turn = se3.hat(t)[:, None] @ _AXES @ R[:, None]
    swing = se3.hat(tangent) @ R[:, None]
    r, J = _residuals(np.concatenate([E[:, None], turn, swing], 1), x_a, x_b, f_a, f_b)
    return r, J, tangent


def _tangent(t: Float) -> Float:
    """(P, 2, 3) unit vectors across unit vectors t (P, 3)."""
    helper = np.eye(3)[np.argmin(np.abs(t), axis=1)]
    first = np.cross(t, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(t, first)], 1)


def _moved(T: Float, step: Float, tangent: Float) -> Float:
    t = T[:, :3, 3] + np.einsum("pk,pki->pi", step[:, 3:], tangent)
    t /= np.linalg.norm(t, axis=1, keepdims=True)
    return se3.compose(se3.so3_exp(step[:, :3]) @ T[:, :3, :3], t)
