"""Relative poses from matches under a given K, for many pairs of views at once.

P: number of pairs, C: matches of a pair, k: parameters of a relative pose. Rays are pixels
back-projected by K, (x, y, 1); p_b = R p_a + t, and x_b^T E x_a = 0 with E = [t]x R. Sampson
distance: Hartley, Zisserman, "Multiple view geometry", 11.4.3.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calm_edge.geometry import se3
from calm_edge.types import Float, Int

Bool = NDArray[np.bool_]

_ITERATIONS = 40
# Stop at this relative decrease of the cost, or above this damping, or below this cost [px^2].
_CONVERGED, _STUCK, _EXACT = 1e-9, 1e6, 1e-18
_AXES = se3.hat(np.eye(3))


def essential(T_b_a: Float) -> Float:
    """Essential matrices E (..., 3, 3) of relative poses (..., 4, 4)."""
    return np.asarray(se3.hat(T_b_a[..., :3, 3]) @ T_b_a[..., :3, :3])


def sampson(E: Float, x_a: Float, x_b: Float, f_a: Float, f_b: Float) -> Float:
    """Signed Sampson distances (P, C) [px] of matches (P, C, 3) under E (P, 3, 3).

    f_a, f_b: (P, 2) focal lengths of the views, px.
    """
    return _residuals(E[:, None], x_a, x_b, f_a, f_b)[0]


class Matches(NamedTuple):
    """Matches of P pairs of views, up to C each.

    x_a, x_b: (P, C, 3) rays. f_a, f_b: (P, 2) focal lengths, px. weight: (P, C), 0 for unused
    entries.
    """

    x_a: Float
    x_b: Float
    f_a: Float
    f_b: Float
    weight: Float

    def of(self, rows: Int) -> Matches:
        """Select pairs by index."""
        return Matches(*(field[rows] for field in self))


def solve(T_b_a: Float, matches: Matches) -> Float:
    """Estimate relative poses (P, 4, 4) with unit translations.

    Each minimises sum weight * sampson^2 over five parameters. T_b_a: (P, 4, 4) initial values.
    """

    def linearised(T: Float, rows: Int) -> _Linear:
        R, t = T[:, :3, :3], T[:, :3, 3]
        turn = se3.hat(t)[:, None] @ _AXES @ R[:, None]
        swing = se3.hat(_tangent(t)) @ R[:, None]
        return _linear(np.concatenate([turn, swing], 1), T, matches.of(rows))

    def moved(T: Float, step: Float) -> Float:
        t = T[:, :3, 3] + (step[:, 3:, None] * _tangent(T[:, :3, 3])).sum(1)
        t /= np.linalg.norm(t, axis=1, keepdims=True)
        return se3.compose(se3.so3_exp(step[:, :3]) @ T[:, :3, :3], t)

    start = np.array(T_b_a)
    start[:, :3, 3] /= np.linalg.norm(start[:, :3, 3], axis=1, keepdims=True)
    return _descend(start, linearised, moved)


def resect(T_b_s: Float, T_s_a: Float, matches: Matches) -> Float:
    """Estimate poses T_b_s (Q, 4, 4) of views b, each against J views a at once.

    Minimises the epipolar error. T_b_s: initial values. T_s_a: (Q, J, 4, 4) fixed poses of the
    views a. matches: Q * J pairs, J for each b. The scale follows from the baselines between the
    views a, or from the initial value if all are collinear.
    """
    J = T_s_a.shape[1]

    def linearised(T: Float, rows: Int) -> _Linear:
        T_b_a = (T[:, None] @ T_s_a[rows]).reshape(-1, 4, 4)
        R, t = T_b_a[:, None, :3, :3], T_b_a[:, :3, 3]
        slopes = np.concatenate([_AXES @ R, _AXES @ se3.hat(t)[:, None] @ R], 1)
        of_pairs = (rows[:, None] * J + np.arange(J)).ravel()
        single = _linear(slopes, T_b_a, matches.of(of_pairs))
        return _Linear(*(x.reshape(-1, J, *x.shape[1:]).sum(1) for x in single))

    def moved(T: Float, step: Float) -> Float:
        R = se3.so3_exp(step[:, 3:])
        return se3.compose(R @ T[:, :3, :3], (R @ T[:, :3, 3:])[..., 0] + step[:, :3])

    return _descend(T_b_s, linearised, moved)


def _descend(
    start: Float,
    linearised: Callable[[Float, Int], _Linear],
    moved: Callable[[Float, Float], Float],
) -> Float:
    """Minimise over independent poses (P, 4, 4) by Levenberg-Marquardt.

    linearised: (poses, their row indices in start) -> normal equations. moved: (poses, steps) ->
    new poses. A step has the k parameters of a pose.
    """
    T, damping = np.array(start), np.full(len(start), 1e-4)
    going = np.arange(len(T))
    state = linearised(T, going)
    for _ in range(_ITERATIONS):
        trial = moved(T[going], state.step(damping[going]))
        there = linearised(trial, going)
        better = there.cost < state.cost
        small = state.cost - there.cost <= _CONVERGED * state.cost
        T[going[better]] = trial[better]
        damping[going] *= np.where(better, 0.2, 8.0)
        state = _Linear(*(_chosen(better, x, y) for x, y in zip(there, state, strict=True)))
        left = ~((better & small) | (damping[going] > _STUCK) | (state.cost < _EXACT))
        going, state = going[left], _Linear(*(x[left] for x in state))
        if not len(going):
            break
    return T


def inverse_depth(T_b_a: Float, x_a: Float, x_b: Float) -> tuple[Float, Float]:
    """Inverse depth (..., C) in view a of matches (..., C, 3), and its information (..., C).

    From x_b x (R x_a + t / z) = 0, linear in 1 / z. The least-squares value over several b is
    sum(information * value) / sum(information). T_b_a: (..., 4, 4).
    """
    turned = x_a @ np.swapaxes(T_b_a[..., :3, :3], -1, -2)
    across = _cross(x_b, T_b_a[..., None, :3, 3])
    information = (across**2).sum(-1)
    value = -(_cross(x_b, turned) * across).sum(-1)
    return value / np.maximum(information, 1e-18), information


def weighted_median(value: Float, weight: Float) -> Float:
    """Weighted median of each row of (P, C); weights >= 0 with a positive sum."""
    order = np.argsort(value, axis=1)
    value = np.take_along_axis(value, order, 1)
    share = np.cumsum(np.take_along_axis(weight, order, 1), axis=1)
    middle = (share < share[:, -1:] / 2).sum(1)
    return np.asarray(value[np.arange(len(value)), middle])


def _residuals(E: Float, x_a: Float, x_b: Float, f_a: Float, f_b: Float) -> tuple[Float, Float]:
    """Sampson distances (P, C), px, and their derivatives (P, k, C) by the k pose parameters.

    E: (P, 1 + k, 3, 3), the essential matrix of each pair, then its k derivatives.
    """
    in_b = E @ np.swapaxes(x_a, 1, 2)[:, None]
    in_a = np.swapaxes(E, -1, -2) @ np.swapaxes(x_b, 1, 2)[:, None]
    value = (in_b * np.swapaxes(x_b, 1, 2)[:, None]).sum(2)
    g_b, g_a = in_b[:, :, :2] / f_b[:, None, :, None], in_a[:, :, :2] / f_a[:, None, :, None]
    norm2 = (g_b[:, 0] ** 2).sum(1) + (g_a[:, 0] ** 2).sum(1) + 1e-30
    norm = np.sqrt(norm2)
    r = value[:, 0] / norm
    half_slope = (g_b[:, 1:] * g_b[:, :1]).sum(2) + (g_a[:, 1:] * g_a[:, :1]).sum(2)
    slope = value[:, 1:] / norm[:, None] - r[:, None] * half_slope / norm2[:, None]
    return r, slope


class _Linear(NamedTuple):
    """Costs (P,) of P poses with gradients (P, k) and Gauss-Newton Hessians (P, k, k).

    k: number of parameters of a pose.
    """

    cost: Float
    gradient: Float
    hessian: Float

    def step(self, damping: Float) -> Float:
        """Levenberg-Marquardt steps (P, k) of k parameters, with a damping factor (P,) per pose."""
        diagonal = np.einsum("pii->pi", self.hessian) + 1e-12
        eye = np.eye(diagonal.shape[1])
        A = self.hessian + (damping[:, None] * diagonal)[:, None] * eye
        return np.asarray(-np.linalg.solve(A, self.gradient[..., None])[..., 0])


def _linear(slopes: Float, T_b_a: Float, matches: Matches) -> _Linear:
    """Linearise the epipolar errors of pairs at T_b_a (P, 4, 4).

    slopes: (P, k, 3, 3) derivatives of the essential matrices by the k parameters of a pose.
    """
    x_a, x_b, f_a, f_b, weight = matches
    E = np.concatenate([essential(T_b_a)[:, None], slopes], 1)
    r, J = _residuals(E, x_a, x_b, f_a, f_b)
    weighted = J * weight[:, None]
    gradient = (weighted @ r[..., None])[..., 0]
    return _Linear((weight * r**2).sum(1), gradient, weighted @ np.swapaxes(J, 1, 2))


def _chosen(mask: Bool, yes: Float, no: Float) -> Float:
    """Select rows of `yes` where mask (P,) is true, else of `no`; both (P, ...)."""
    return np.where(mask.reshape(-1, *[1] * (yes.ndim - 1)), yes, no)


def _cross(a: Float, b: Float) -> Float:
    """Cross product of vectors (..., 3), several times faster than np.cross on many short rows."""
    return np.stack(
        [
            a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1],
            a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2],
            a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0],
        ],
        -1,
    )


def _tangent(t: Float) -> Float:
    """Two orthogonal unit vectors (P, 2, 3) that are orthogonal to unit vectors t (P, 3)."""
    helper = np.eye(3)[np.argmin(np.abs(t), axis=1)]
    first = _cross(t, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, _cross(t, first)], 1)
