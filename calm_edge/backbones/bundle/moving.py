"""Test which tracks of a solved window move by themselves, as cars do.

Pictures of one eye cannot tell: seen from a car at constant speed, a point with a constant velocity
of its own looks like one that stands still at another distance. The other eye shows the distance at
nearly one instant. So a track of both eyes is fitted twice under the window's poses, each
observation at the instant of its row: as a point that stands still and as one with a constant
velocity of its own. It moves if the first fit is beyond chance (chi-square) and the second explains
what the first does not; if neither does, its matches are wrong, and the robust kernel deals with
these.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, fdtri

from calm_edge.backbones.bundle import window
from calm_edge.backbones.bundle.normal_equations import Groups, grouped
from calm_edge.backbones.bundle.problem import (
    NEAREST,
    Measurements,
    State,
    exposed_points,
    view_rates,
)
from calm_edge.backbones.bundle.solver import Solution
from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera
from calm_edge.kit import layout
from calm_edge.types import Float, Int

Bool = NDArray[np.bool_]

# Least parallax between the eyes [px]: a point with less is undecided.
REACH_PX = 2.0
# Longest time between the exposures of both eyes that counts as nearly one instant [s].
ONE_INSTANT_S = 0.1
# Least number of such pairs: a single wrong match across the eyes looks like a motion.
LEAST_PAIRS = 2
# Least number of observations: a velocity explains any three or four.
LEAST_SEEN = 5
# Probabilities that a point that stands still exceeds the chi-square, and that a velocity explains
# so much more of its errors.
CHANCE, EXPLAINED = 1e-6, 1e-3
# Largest variance of the errors that a constant velocity may leave: no car keeps it exactly.
MOST_LEFT = 4.0
# Smallest sigma of the errors, in those of the matches: what lens and drift of tracks leave.
LEAST_SIGMA = 0.5
# Distance from the prediction up to which a lens is as good as linear.
NEAR_PX = 40.0
# Rounds of least squares, each with the depths of the one before.
ROUNDS = 4


@dataclass(frozen=True, slots=True)
class Fits:
    """Chi-square of P points under the two hypotheses, with degrees of freedom.

    still, moves: (P,) chi-square as a point that stands still, and with a velocity of its own.
    n: (P,) observations.
    """

    still: Float
    moves: Float
    n: Int

    @property
    def own_motion(self) -> Bool:
        """Which points (P,) a velocity of their own explains, and standing still does not."""
        dof = 2 * self.n - 6
        left = self.moves / dof
        gain = (self.still - self.moves) / 3
        explained = gain > fdtri(3, dof, 1 - EXPLAINED) * np.maximum(left, 1.0)
        explained &= left < MOST_LEFT
        return np.asarray(explained & (self.still > chdtri(2 * self.n - 3, CHANCE)))


def without_moving(solution: Solution, m: Measurements) -> tuple[Solution, Measurements]:
    """A solution and its measurements without the points that move; as they are if few are left."""
    gone = moving(solution, m)
    if not gone.any() or (~gone).sum() < window.MIN_POINTS:
        return solution, m
    residual = solution.residual[~gone[m.point]]
    left, state = window.without(m, solution.state, gone)
    return replace(solution, state=state, residual=residual), left


def moving(solution: Solution, m: Measurements) -> Bool:
    """Which points of a solved window (M,) move by themselves."""
    state, n_points = solution.state, len(solution.state.points)
    sigma = max(float(np.median(solution.residual)) / np.sqrt(2 * np.log(2)), LEAST_SIGMA)
    n = np.bincount(m.point, minlength=n_points)
    square = np.bincount(m.point, (solution.residual / sigma) ** 2, n_points)
    # the robust solution's chi-square is an upper bound of that of the least-squares point
    limit = chdtri(np.maximum(2 * np.arange(n.max() + 1) - 3, 1), CHANCE)
    doubtful = (n >= LEAST_SEEN) & (square > limit[n])
    out = np.zeros(n_points, bool)
    part = m.at(np.flatnonzero(doubtful[m.point]))
    seen = observed(state, part)
    if not np.isfinite(seen).all():
        kept = np.flatnonzero(np.isfinite(seen[:, 0]))
        part, seen = part.at(kept), seen[kept]
    (chosen,) = np.nonzero(in_reach(state, part, seen, n_points))
    if len(chosen):
        rows = np.flatnonzero(np.isin(part.point, chosen))
        out[chosen] = fits(state, part.at(rows), seen[rows], sigma).own_motion
    return out


def observed(state: State, m: Measurements) -> Float:
    """Observed rays (O, 2) on z = 1; NaN where the lens has none.

    Through the lens at the predicted rays, unless these are far off: an inversion is slower.
    """
    p_c = exposed_points(state, m)[0].T
    z = np.where(p_c[:, 2] > NEAREST, p_c[:, 2], NEAREST)
    q = p_c[:, :2] / z[:, None]
    for eye, camera in enumerate(layout.cameras(state.theta, m.size)):
        (own,) = np.nonzero(m.eye[m.view] == eye)
        off = m.uv[own] - camera.project(p_c[own])
        near = (p_c[own, 2] > NEAREST) & (np.abs(off).max(1) < NEAR_PX)
        q[own[~near]] = camera.normalized(m.uv[own[~near]])
        own, off = own[near], off[near]
        q[own] += np.linalg.solve(_by_ray(camera, q[own]), off[..., None])[..., 0]
    return np.asarray(q)


def _by_ray(camera: Camera, q: Float) -> Float:
    """Derivatives (N, 2, 2) of pixels by rays (N, 2) on z = 1."""
    return camera.project_jacobian(np.c_[q, np.ones(len(q))])[:, :, :2]


def in_reach(state: State, m: Measurements, seen: Float, n_points: int) -> Bool:
    """Which points (M,) both eyes see at nearly one instant, and not too far away.

    seen: (O, 2) observed rays.
    """
    a, b = _pairs(m, float(state.theta[layout.TIME_OFFSET]))
    R_c_s = state.T_c_s[:, :3, :3]
    R_a_p = R_c_s[m.view[b]] @ np.swapaxes(R_c_s[m.view[a]], 1, 2)
    far = (R_a_p @ np.c_[seen[a], np.ones(len(a))][..., None])[..., 0]
    assistant = layout.cameras(state.theta, m.size)[1]
    parallax = np.linalg.norm(assistant.project(far) - m.uv[b], axis=1)
    largest = np.zeros(n_points)
    np.maximum.at(largest, m.point[a], parallax)
    enough = np.bincount(m.point[a], minlength=n_points) >= LEAST_PAIRS
    return np.asarray(enough & (largest >= REACH_PX))


def _pairs(m: Measurements, late_s: float) -> tuple[Int, Int]:
    """Observations of one point by both eyes: rows (L,) of the primary, (L,) of the assistant."""
    (views,) = np.nonzero(m.eye == 0)
    apart = np.abs(m.t[:, None] + late_s * m.eye[:, None] - m.t[views])
    nearest, close = views[apart.argmin(1)], apart.min(1) < ONE_INSTANT_S
    own = m.eye[m.view] == 0
    a, b = np.flatnonzero(own), np.flatnonzero(~own & close[m.view])
    key = m.point * m.n_views
    _, i, j = np.intersect1d(key[a] + m.view[a], key[b] + nearest[m.view[b]], return_indices=True)
    return a[i], b[j]


def fits(state: State, m: Measurements, seen: Float, sigma: float) -> Fits:
    """Fit all P points of the measurements under either hypothesis, in order of their indices.

    seen: (O, 2) observed rays. sigma: of the errors, in sigmas of m.
    """
    by_point = grouped(m.point)
    point = np.searchsorted(by_point.keys, m.point)
    A = _to_views(state, m)
    rows = _errors(A, state, m, seen)
    z = (A[2, :4] * state.points[m.point].T).sum(0)
    still = _least(rows[:, :4], A[2, :4], z, by_point, point)
    moves = _least(rows, A[2], z, by_point, point)
    return Fits(still / sigma**2, moves / sigma**2, np.bincount(point))


def _to_views(state: State, m: Measurements) -> Float:
    """Matrices (3, 7, O) to the axes of each view, at the instant of each observation's row.

    They take position, weight, and velocity times weight; times count from the window's middle.
    """
    eye = m.eye[m.view]
    late = state.theta[layout.READOUT][eye] * (m.uv[:, 1] / (m.size[eye, 1] - 1) - 0.5)
    rate = view_rates(state.T_c_s, m)
    moved = se3.hat(rate[:, 3:]) @ state.T_c_s[:, :3, :]
    moved[:, :, 3] += rate[:, :3]
    T = np.moveaxis(state.T_c_s[m.view, :3] + late[:, None, None] * moved[m.view], 0, -1)
    t = m.t[m.view] + state.theta[layout.TIME_OFFSET] * eye + late
    t -= (m.t.min() + m.t.max()) / 2
    return np.concatenate([T, t * T[:, :3]], 1)


def _errors(A: Float, state: State, m: Measurements, seen: Float) -> Float:
    """Errors (2, 7, O) in sigmas, times the z of their points, by the unknowns of `_to_views`."""
    out = np.zeros((A.shape[1], 2, len(m.view)))
    for eye, camera in enumerate(layout.cameras(state.theta, m.size)):
        (own,) = np.nonzero(m.eye[m.view] == eye)
        off = A[:2][:, :, own] - seen[own].T[:, None] * A[2][:, own]
        out[:, :, own] = np.einsum("oij,jko->kio", _by_ray(camera, seen[own]), off)
    return np.swapaxes(m.whitened(out), 0, 1)


def _least(rows: Float, by_z: Float, z: Float, by_point: Groups, point: Int) -> Float:
    """Least sums of squares (P,) over homogeneous unknowns of each point.

    rows: (2, K, O) errors times z. by_z: (K, O) z by the unknowns. z: (O,) to start from.
    """
    values = np.zeros((0, 1))
    for _ in range(ROUNDS):
        near = np.where(np.abs(z) < NEAREST, NEAREST, z)
        scaled = rows / near
        blocks = np.einsum("iko,ilo->klo", scaled, scaled)
        values, vectors = np.linalg.eigh(np.moveaxis(by_point.sum(blocks), -1, 0))
        z = (by_z * vectors[:, :, 0].T[:, point]).sum(0)
    return np.asarray(values[:, 0])
