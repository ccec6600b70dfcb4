"""Covariance of a solved window's poses and kit, and the sigma of its scale.

The inverse Hessian is no covariance here: errors along a track are correlated, the sigmas of the
matches are no more than weights, and the kernel is robust. So the covariance is A^-1 B A^-1 of an
M-estimator (Huber, Robust Statistics, 1981, chapter 6), clustered by cells of the picture, as in
`evidence` (Liang and Zeger, Longitudinal Data Analysis Using Generalized Linear Models, 1986): A is
the derivative of the gradient that the solver makes zero, and B the gradient's covariance, a sum
over

- cells: the outer product of the part of each cell's tracks, which share a surface and its errors;
- an error that all matches across the cameras share;
- a bend of the picture that looks like another focal unless the car turns (`evidence`);
- the rig ties, which have the sigmas that they claim;
- the prior on the kit.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calm_edge.backbones.bundle.evidence import FOCALS, cell_sums, unturned_sigma
from calm_edge.backbones.bundle.normal_equations import (
    Structure,
    normal_equations,
    tie_equations,
    track_gradients,
)
from calm_edge.backbones.bundle.problem import (
    Measurements,
    RigTies,
    State,
    project,
    reprojection,
    tangent_basis,
)
from calm_edge.backbones.bundle.solver import Solution, add_priors, robust_weights
from calm_edge.geometry import se3
from calm_edge.kit import layout
from calm_edge.types import Float, Int, KitBelief

# Neighbouring cells share errors too, and a fit to few cells hides part of them: as many as this
# count as one. Fitted to the errors of scale of windows on 8 rendered drives.
CELLS_ALIKE = 2.0
# Matches across the cameras are biased towards the near where foreground and background share a
# patch: common error of near points against far ones, as a share of the window's median residual.
# It is in full at a parallax of NEAR_PX.
COMMON_SHARE = 0.4
NEAR_PX = 1.0
# Largest sigma of the log focal by a bend of the picture: as of a focal that is unknown.
MOST_BENT = 0.3
# Observations of less weight are outliers. One of a point near a camera has leverage whatever its
# weight, and its residual is no sample of the errors of the others.
LEAST_WEIGHT = 0.01
# Keeps the information regular where a pose is all but free [1 / spacings^2, 1 / rad^2].
_FLOOR = 1e-9


@dataclass(frozen=True)
class Posterior:
    """Covariance (D, D) of a window's unknowns: 6 for each of its C views, then the kit.

    Of a view (translation [spacings], rotation [rad]) in its own axes, relative to view 0; of the
    kit as in kit/layout.py. The spacing is one. View 0 is exact. inverse: (D, D) of A. scatter:
    (D, D) B.
    """

    inverse: Float
    scatter: Float

    @cached_property
    def covariance(self) -> Float:
        """A^-1 B A^-1."""
        return np.asarray(self.inverse @ self.scatter @ self.inverse)

    def joined(self, J: Float, information: float, sigma: float) -> Posterior:
        """The posterior with a scalar that is measured beside the pictures.

        J: (6 C,) its derivative by twists on the left of the views. information: with which the
        solver counts it. sigma: its true one.
        """
        column = np.zeros(len(self.inverse))
        column[6 : len(J)] = J[6:]
        moved = self.inverse @ column
        weaker = np.outer(moved, moved) / (1 / information + column @ moved)
        noise = (information * sigma) ** 2 * np.outer(column, column)
        return Posterior(self.inverse - weaker, self.scatter + noise)

    def of_views(self, views: Int) -> Float:
        """Covariance (6 V, 6 V) of the poses of views (V,)."""
        rows = (6 * np.asarray(views)[:, None] + np.arange(6)).ravel()
        return np.asarray(self.covariance[np.ix_(rows, rows)])

    def scale_log_sigma(self, state: State, m: Measurements) -> float:
        """Sigma of the log of the primary's path length in spacings; inf if it did not move."""
        return self.length_log_sigma(state, np.flatnonzero(m.eye == 0))

    def length_log_sigma(self, state: State, views: Int) -> float:
        """Sigma of the log of the path's length through views (V,); inf if that is only noise.

        Noise makes a path longer, at standstill it is all of it. So the sigma is divided by the
        share of the steps' squared lengths that exceeds their variance.
        """
        step, by_pose = steps(state, views)
        J = by_pose.reshape(-1, by_pose.shape[-1])
        covariance = J @ self.covariance[: J.shape[1], : J.shape[1]] @ J.T
        length = np.linalg.norm(step, axis=1)
        energy = max(float(length @ length), 1e-12)
        along = (step / np.maximum(length, 1e-12)[:, None]).ravel()
        share = 1 - float(np.trace(covariance)) / energy
        if share <= 0:
            return float(np.inf)
        return float(np.sqrt(along @ covariance @ along) / length.sum() / share)


def posterior(
    solution: Solution,
    m: Measurements,
    ties: RigTies,
    prior: KitBelief,
    robust_scale: float,
    stiffness: float,
) -> Posterior:
    """Covariance of a window's solution.

    prior, robust_scale: as given to `solve`. stiffness: factor by which the prior's information
    exceeds what is known of the kit; it sets the prior's weight against the pixels'.
    """
    state, n_points = solution.state, len(solution.state.points)
    jac = reprojection(state, m, tangent_basis(state.points))
    weight = robust_weights(solution.residual, robust_scale)
    weight = np.where(weight < LEAST_WEIGHT, 0.0, weight)
    # The mean over directions of the derivative of weight times residual, for Cauchy's kernel
    slope = weight**2
    bare = normal_equations(state, m, ties, Structure.of(m, n_points), slope, 0.0)
    A = add_priors(bare, state, prior)[0]

    error = (jac.predicted - m.uv).T
    cells = cell_sums(track_gradients(m, jac, bare, weight * error), m)
    common = track_gradients(m, jac, bare, slope * _common_error(solution, m).T).sum(1)
    B = CELLS_ALIKE * cells @ cells.T + np.outer(common, common)
    B += tie_equations(state, m, ties)[0]
    bent = _by_kit(bare.H, len(A)) @ FOCALS * min(unturned_sigma(state, m), MOST_BENT)
    B[-layout.SIZE :, -layout.SIZE :] += stiffness * prior.information + np.outer(bent, bent)

    inverse = np.zeros_like(A)
    inverse[6:, 6:] = np.linalg.inv(A[6:, 6:] + _FLOOR * np.eye(len(A) - 6))
    return Posterior(inverse, B)


def _by_kit(H: Float, size: int) -> Float:
    """Information of the pixels on the kit, poses marginalised out, (SIZE, SIZE).

    H: (size, size), without priors.
    """
    poses, kit = slice(6, size - layout.SIZE), slice(size - layout.SIZE, size)
    held = H[poses, poses] + _FLOOR * np.eye(size - layout.SIZE - 6)
    return np.asarray(H[kit, kit] - H[kit, poses] @ np.linalg.solve(held, H[poses, kit]))


def _common_error(solution: Solution, m: Measurements) -> Float:
    """One sigma (O, 2) px of the error that all matches across the cameras share."""
    state, assistant = solution.state, np.flatnonzero(m.eye == 1)
    # the assistant's views moved to the primary's centre: what is left of the parallax is none
    rig = layout.rig(state.theta)
    turned = rig.copy()
    turned[:3, 3] = 0
    T_c_s = state.T_c_s.copy()
    T_c_s[assistant] = se3.inverse(turned) @ rig @ T_c_s[assistant]
    far = State(T_c_s, state.points, state.theta)
    parallax = project(state, m)[0] - project(far, m)[0]
    length = np.maximum(np.linalg.norm(parallax, axis=1), 1e-9)
    size = COMMON_SHARE * float(np.median(solution.residual * m.sigma_px))
    return np.asarray(parallax * (size / np.maximum(length, NEAR_PX))[:, None])


def steps(state: State, views: Int) -> tuple[Float, Float]:
    """Steps (S, 3) between the centres of consecutive views (S + 1,), and derivatives (S, 3, 6 C).

    In spacings; by a motion (translation, rotation) of each of the C views in its own axes.
    """
    T_s_c = se3.inverse(state.T_c_s[views])
    by_view = np.zeros((len(views), 3, len(state.T_c_s), 6))
    by_view[np.arange(len(views)), :, views, :3] = T_s_c[:, :3, :3]
    flat = by_view.reshape(len(views), 3, -1)
    return np.diff(T_s_c[:, :3, 3], axis=0), np.diff(flat, axis=0)
