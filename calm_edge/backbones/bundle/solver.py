"""Levenberg-Marquardt on one window."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import scipy.linalg

from calm_edge.backbones.bundle.normal_equations import (
    Normal,
    Structure,
    fix_spacing,
    normal_equations,
)
from calm_edge.backbones.bundle.problem import (
    NEAREST,
    Measurements,
    RigTies,
    State,
    move_points,
    project,
    tangent_basis,
    tie_residuals,
)
from calm_edge.geometry import se3
from calm_edge.kit import layout
from calm_edge.types import Float, KitBelief

BEHIND = 100.0  # residual [sigmas] of a point behind its view: counts as an outlier


class PosePrior(Protocol):
    """What is known of a window's poses beside its pictures; no part of its evidence on the kit."""

    def cost(self, state: State) -> float:
        """Squared length of the residuals in sigmas."""
        ...

    def add_to(self, H: Float, g: Float, state: State) -> None:
        """Add the prior, linearised at the state, to normal equations of poses and kit."""
        ...


@dataclass(frozen=True, slots=True)
class Solution:
    """Solved state, its robust cost, and the reprojection errors' lengths (O,) in sigmas."""

    state: State
    cost: float
    residual: Float


def robust_weights(residual: Float, scale: float) -> Float:
    """Cauchy weights (O,) of residual lengths (O,) in sigmas; at a length of `scale` one half."""
    return np.asarray(1 / (1 + (residual / scale) ** 2))


def whitened_lengths(state: State, m: Measurements) -> Float:
    """Lengths (O,) of the reprojection errors in sigmas; BEHIND for points behind their view."""
    predicted, z = project(state, m)
    length = np.linalg.norm(m.whitened((predicted - m.uv).T), axis=0)
    return np.where(z > NEAREST, np.minimum(length, BEHIND), BEHIND)


def total_cost(
    state: State,
    residual: Float,
    ties: RigTies,
    prior: KitBelief,
    scale: float,
    pose_priors: Sequence[PosePrior] = (),
) -> float:
    """Half the robust cost of pixels, rig ties, and the priors on kit and poses.

    residual: (O,) the state's `whitened_lengths`.
    """
    pixels = scale**2 * np.log1p((residual / scale) ** 2).sum()
    T = state.T_c_s
    tie = tie_residuals(
        T[ties.before], T[ties.after], T[ties.assistant],
        layout.rig(state.theta), float(state.theta[layout.TIME_OFFSET]), ties,
    )  # fmt: skip
    off = state.theta - prior.mean
    known = off @ prior.information @ off + sum(other.cost(state) for other in pose_priors)
    return 0.5 * float(pixels + (tie**2).sum() + known)


def add_priors(
    normal: Normal, state: State, prior: KitBelief, pose_priors: Sequence[PosePrior] = ()
) -> tuple[Float, Float]:
    """Add the priors on kit and poses, and the gauge, to the reduced normal equations H, g."""
    H, g = normal.H.copy(), normal.g.copy()
    k = slice(len(g) - layout.SIZE, len(g))
    H[k, k] += prior.information
    g[k] += prior.information @ (state.theta - prior.mean)
    for other in pose_priors:
        other.add_to(H, g, state)
    fix_spacing(H, state.theta, layout.SPACING_SIGMA)
    return H, g


def _step(state: State, n_views: int, delta: Float, delta_points: Float) -> State:
    """Apply a step, then rescale the scene so that the spacing is one again."""
    poses = se3.exp(delta[: 6 * n_views].reshape(n_views, 6)) @ state.T_c_s
    points = move_points(state.points, tangent_basis(state.points), delta_points)
    theta = state.theta + delta[-layout.SIZE :]
    spacing = np.linalg.norm(theta[layout.RIG_CENTRE])
    poses[:, :3, 3] /= spacing
    theta[layout.RIG_CENTRE] /= spacing
    points[:, 3] *= spacing
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    return State(poses, points, theta)


def solve(
    state: State,
    m: Measurements,
    ties: RigTies,
    prior: KitBelief,
    *,
    pose_priors: Sequence[PosePrior] = (),
    robust_scale: float = 2.0,
    max_iterations: int = 30,
    tolerance: float = 1e-4,
) -> Solution:
    """Minimise pixels (Cauchy), rig ties and the priors from `state`, with view 0 fixed.

    Levenberg-Marquardt with iteratively reweighted least squares. prior: on the kit. pose_priors:
    on the poses. robust_scale: of the Cauchy kernel [sigmas]. tolerance: relative decrease of the
    cost at which to stop.
    """
    structure = Structure.of(m, len(state.points))
    damping = 1e-3
    residual = whitened_lengths(state, m)
    cost = total_cost(state, residual, ties, prior, robust_scale, pose_priors)
    n = m.n_views
    for _ in range(max_iterations):
        weight = robust_weights(residual, robust_scale)
        normal = normal_equations(state, m, ties, structure, weight, damping)
        H, g = add_priors(normal, state, prior, pose_priors)
        H[np.diag_indices_from(H)] *= 1 + damping
        free = slice(6, len(g))
        delta = np.zeros(len(g))
        try:
            delta[free] = -scipy.linalg.cho_solve(
                scipy.linalg.cho_factor(H[free, free], check_finite=False),
                g[free],
                check_finite=False,
            )
        except np.linalg.LinAlgError:
            damping *= 10
            continue
        trial = _step(state, n, delta, normal.point_step(delta))
        trial_residual = whitened_lengths(trial, m)
        trial_cost = total_cost(trial, trial_residual, ties, prior, robust_scale, pose_priors)
        if trial_cost < cost:
            gain = (cost - trial_cost) / max(cost, 1e-12)
            state, cost, residual = trial, trial_cost, trial_residual
            damping = max(damping / 10, 1e-9)
            if gain < tolerance:
                break
        else:
            damping *= 10
            if damping > 1e8:
                break
    return Solution(state, cost, residual)
