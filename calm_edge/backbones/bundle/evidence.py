"""Evidence of a solved window on the kit, with a covariance that contains correlated errors.

Errors of matches are correlated along a track, and among tracks that cross the same texture, edge
or moving car. So the covariance is not that of independent observations but is measured on the
residuals, summed over cells of the picture: A^-1 B A^-1 with A the curvature of the cost and B the
scatter of the cells' gradients (Huber, The Behavior of Maximum Likelihood Estimates under
Nonstandard Conditions, 1967; Liang and Zeger, Longitudinal Data Analysis, 1986).

Cells cannot show what all windows share: shape of the lens, bias of the matches, shutter. A part of
it looks like an error of the kit and never averages out. It is taken for COMMON of the matches'
sigma over all of a drive's matches: so what it does to the focal depends on how far the motion
moves pixels when the focal changes, which is far in a turn and hardly on a straight road.
"""

from __future__ import annotations

import numpy as np

from calm_edge.backbones.bundle.normal_equations import (
    Structure,
    fix_spacing,
    normal_equations,
    tie_equations,
    track_gradients,
)
from calm_edge.backbones.bundle.problem import (
    Measurements,
    RigTies,
    State,
    reprojection,
    tangent_basis,
)
from calm_edge.backbones.bundle.solver import Solution, robust_weights
from calm_edge.geometry import se3
from calm_edge.kit import layout
from calm_edge.kit.belief import blurred, scaled
from calm_edge.types import Float, Int, KitBelief

# Cells a picture's width: tracks that start in one cell share their errors.
CELLS_ACROSS = 16
# Root mean square of that part, in sigmas of the matches; fitted to drives whose focal is known.
COMMON = 0.01
# Common part of the sigma of log focal above which a window has hardly a say.
SHOWN = 0.05
# Only a turn moves far points by a length that is known in angles; on a straight road a bend of the
# picture of this size, such as of a lens or of biased matches, looks like another focal.
BIAS_PX = 0.3
# Least ratio of the errors' variance to the matches' sigmas squared: 0.02 px.
LEAST_EXCESS = 1e-3
# Both focals together.
FOCALS = np.zeros(layout.SIZE)
FOCALS[layout.LOG_FOCAL] = 1.0
# Keeps the information regular where a pose is all but free [1 / spacings^2, 1 / rad^2].
_FLOOR = 1e-9
# Eigenvalues of the information below this share of the largest count as rounding errors.
_ROUNDING = 1e-9


def kit_evidence(
    solution: Solution, m: Measurements, ties: RigTies, robust_scale: float
) -> KitBelief:
    """Gaussian on the kit from this window alone: poses and points marginalised out, no prior.

    The mean is one Newton step from the solution. The curvature of the Cauchy kernel, averaged over
    the direction of a residual, is its weight squared.
    """
    state, n = solution.state, 6 * m.n_views
    weight = robust_weights(solution.residual, robust_scale)
    structure = Structure.of(m, len(state.points))
    normal = normal_equations(state, m, ties, structure, weight**2, 0.0)
    H = normal.H[6:, 6:]
    poses, kit = slice(0, n - 6), slice(n - 6, None)
    by_pose = np.linalg.solve(H[poses, poses] + _FLOOR * np.eye(n - 6), H[poses, kit])
    A = H[kit, kit] - H[kit, poses] @ by_pose

    # a gradient by poses and kit, times this, is that by the kit with the poses marginalised out
    reduced = np.concatenate([np.zeros((6, layout.SIZE)), -by_pose, np.eye(layout.SIZE)])
    jac = reprojection(state, m, tangent_basis(state.points))
    tracks = track_gradients(m, jac, normal, weight * (jac.predicted - m.uv).T)
    cells = cell_sums(tracks, m).T @ reduced
    by_ties = tie_equations(state, m, ties)
    gradient = cells.sum(0) + by_ties[1] @ reduced
    B = cells.T @ cells + reduced.T @ by_ties[0] @ reduced
    # how much larger the errors are than the matches' sigmas: the scale of the weights, not theirs
    moved = np.diag(A) > 0  # all but the families of the lenses
    excess = max(float(np.mean(np.diag(B)[moved] / np.diag(A)[moved])), LEAST_EXCESS)
    information, noise = (A + A.T) / 2 / excess, B / excess**2
    # makes the information regular along t_p_a, whose length is the unit
    for matrix in (information, noise):
        fix_spacing(matrix, state.theta, layout.EVIDENCE_SPACING_SIGMA)
    values, vectors = np.linalg.eigh(information)
    known = vectors[:, values > _ROUNDING * max(values.max(), 1e-12)]
    kept, projector = values[-known.shape[1] :], known @ known.T
    mean = state.theta - (known / kept) @ (known.T @ gradient) / excess
    kept_information = layout.with_known_families((known * kept) @ known.T)
    common = COMMON**2 * float(2 * (weight**2).sum() / excess)
    belief = KitBelief(
        mean, kept_information, projector @ noise @ projector, kept_information, common
    )
    prior = layout.prior((None, None), families=layout.families(state.theta))
    bounded = np.linalg.inv(kept_information + prior.information)
    unturned = unturned_sigma(state, m)
    belief = blurred(belief, FOCALS, unturned)
    variance = common * bounded[layout.LOG_FOCAL, layout.LOG_FOCAL].max() + unturned**2
    hidden = variance / SHOWN**2
    # many windows that hardly show the focal must not outvote one that does
    return scaled(belief, (1 + hidden) ** -2)


def unturned_sigma(state: State, m: Measurements) -> float:
    """Sigma of the log of both focals by a bend of the picture, which only a turn tells apart."""
    return BIAS_PX / max(_turn_px(state, m), BIAS_PX * 1e-3)


def _turn_px(state: State, m: Measurements) -> float:
    """By how much the picture of far points moves while the primary turns in the window [px]."""
    R_c_s = state.T_c_s[m.eye == 0, :3, :3]
    turn = se3.so3_log(R_c_s @ R_c_s[0].T)[:, :2]  # about the optical axis shows no focal
    f = layout.cameras(state.theta, m.size)[0].fx
    return float(f * np.linalg.norm(np.ptp(turn, axis=0)))


def cell_sums(by_track: Float, m: Measurements) -> Float:
    """Sum parts (D, M) of the gradient by point over the points of each of G cells: (D, G)."""
    cell = _cells(m, by_track.shape[1])
    rows = np.zeros((cell.max() + 1, len(by_track)))
    np.add.at(rows, cell, by_track.T)
    return rows.T


def _cells(m: Measurements, n_points: int) -> Int:
    """Cell (M,) of the picture in which each point was first observed; both eyes numbered."""
    seen, first = np.unique(m.point, return_index=True)
    eye = m.eye[m.view[first]]
    place = (m.uv[first] * (CELLS_ACROSS / m.size[eye, :1])).astype(np.int64)
    key = np.c_[eye, place] @ [CELLS_ACROSS**4, CELLS_ACROSS**2, 1]
    cell = np.zeros(n_points, np.int64)
    cell[seen] = np.unique(key, return_inverse=True)[1]
    return cell
