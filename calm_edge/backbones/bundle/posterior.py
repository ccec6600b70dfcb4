"""Posterior sigma of a solved window's scale, given the spacing between the cameras."""

from __future__ import annotations

import numpy as np

from calm_edge.backbones.bundle.normal_equations import Structure, normal_equations
from calm_edge.backbones.bundle.problem import Measurements, RigTies, State
from calm_edge.backbones.bundle.solver import Solution, fix_spacing, robust_weights
from calm_edge.geometry import se3
from calm_edge.kit import layout
from calm_edge.types import Float, KitBelief

# Keeps the information regular where a pose is all but free [1 / spacings^2, 1 / rad^2].
_FLOOR = 1e-9


def scale_log_sigma(
    solution: Solution,
    m: Measurements,
    ties: RigTies,
    belief: KitBelief,
    robust_scale: float,
    tempering: float,
) -> float:
    """Sigma of the log of the primary's path length in spacings; inf if it did not move.

    Poses, points and kit are marginalised out. belief: on the kit, as in the window's solution.
    tempering: factor on the information of the pixels, whose errors are correlated.

    Noise makes a path longer, at standstill it is all of it. So the sigma is divided by the share
    of the steps' squared lengths that exceeds their variance.
    """
    state = solution.state
    weight = robust_weights(solution.residual, robust_scale)
    normal = normal_equations(state, m, ties, Structure.of(m, len(state.points)), weight, 0.0)
    H = tempering * normal.H
    H[-layout.SIZE :, -layout.SIZE :] += belief.information
    fix_spacing(H, state.theta, layout.SPACING_SIGMA)
    free = H[6:, 6:] + _FLOOR * np.eye(len(H) - 6)
    step, by_pose = _steps(state, m)
    J = by_pose[..., 6 : 6 * m.n_views].reshape(-1, 6 * m.n_views - 6)
    covariance = J @ np.linalg.inv(free)[: J.shape[1], : J.shape[1]] @ J.T
    length = np.linalg.norm(step, axis=1)
    along = (step / np.maximum(length, 1e-12)[:, None]).reshape(-1)
    energy = float(length @ length)
    share = 1 - float(np.trace(covariance)) / max(energy, 1e-12)
    if share <= 0:
        return float(np.inf)
    return float(np.sqrt(along @ covariance @ along) / length.sum() / share)


def _steps(state: State, m: Measurements) -> tuple[Float, Float]:
    """Steps (S, 3) between the primary's centres [spacings], and derivatives (S, 3, 6 C).

    By a step of T_c_s from the left, (translation, rotation), of each of the C views.
    """
    (primary,) = np.nonzero(m.eye == 0)
    T_s_c = se3.inverse(state.T_c_s[primary])
    by_view = np.zeros((len(primary), 3, m.n_views, 6))
    # T_c_s -> exp(d) T_c_s moves the centre by -R_s_c d_translation; a rotation leaves it
    by_view[np.arange(len(primary)), :, primary, :3] = -T_s_c[:, :3, :3]
    flat = by_view.reshape(len(primary), 3, -1)
    return np.diff(T_s_c[:, :3, 3], axis=0), np.diff(flat, axis=0)
