"""First guess of the primary's path without random sampling: a car moves along one axis.

With the direction of travel given in camera axes, the epipolar constraint of neighbouring keyframes
depends on their rotation alone. Iteratively reweighted least squares solves for all rotations and
the direction together, starting from zero rotation. The remaining motion of a point, along the
direction of travel, gives the step (length travelled between two keyframes) divided by the point's
distance; two steps that share points therefore have a ratio, and all ratios together give signed
steps. Standing and reversing are steps like others.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.linalg import eigh

from calm_edge.backbones.bundle.normal_equations import Groups, grouped
from calm_edge.backbones.bundle.problem import Measurements
from calm_edge.geometry import se3
from calm_edge.types import Float, Int

ITERATIONS = 18
# scale of the Cauchy weights of the epipolar residual: wide first, to reach a wrong direction, then
# narrowed by this factor an iteration down to the noise of matches
FIRST_PX, NARROWING, EPIPOLAR_PX = 20.0, 0.7, 0.7
# points nearer to the direction of travel than this [rad] have a small weight at first, narrowed
# alike: there the residual is far from linear, and a wrong direction would never leave them
FIRST_RAD = 1.0
# points that move less than this along the direction of travel count as far, with a small weight
# that fixes the rotation of a car that stands
FAR_PX, FAR_WEIGHT = 2.0, 0.02
# lower bound of the angle between a point and the direction of travel: nearer points hardly move
NEAREST_RAD = 0.01
# Angles [degrees] to the right of the optical axis at which the search for an unknown direction of
# travel begins; each finds those within about 15 degrees, the outer ones up to twice as far.
SEARCHED_DEG = (0.0, -30.0, 30.0)
# A direction found there is tried too if its robust cost is below this share of that ahead, and the
# cosine of its angle to the optical axis above MOST_ASIDE: sideways motion of points near the
# horizon leaves too little across the direction of travel to compare.
BETTER, MOST_ASIDE = 0.97, 0.4
# sigmas of priors: angle between the direction of travel and its first guess, unknown or remembered
# from earlier windows; change of speed from one step to the next, as a share of the median speed
DIRECTION_SIGMA_RAD, REMEMBERED_SIGMA_RAD = 0.3, 0.03
SPEED_SIGMA = 0.1
# Cauchy scale [sigmas] of the equation that one point gives for two consecutive steps
RATIO_SIGMAS = 1.0
# a step counts as backwards if more of its points show this than the contrary, by this many
# standard deviations of a vote by chance (the root of their number)
REVERSE_SIGMAS = 3.0
TINY = 1e-12


@dataclass(frozen=True, slots=True)
class Matches:
    """Matches of P pairs of consecutive keyframes, one row a match.

    a, b: (n, 3) unit rays in the earlier and the later keyframe. pair: (n,) index of the pair.
    point: (n,) track. dt: (P,) seconds between the keyframes of each pair. f: focal [px].
    """

    a: Float
    b: Float
    pair: Int
    point: Int
    dt: Float
    f: float


def matches(m: Measurements, rays: Float, f: float) -> Matches:
    """The matches of a window's primary views; rays: (O, 2) of its observations, on z = 1."""
    bearing = np.c_[rays, np.ones(len(rays))]
    bearing /= np.linalg.norm(bearing, axis=1, keepdims=True)
    views = [np.flatnonzero(m.view == v) for v in np.flatnonzero(m.eye == 0)]
    a, b, pair = [], [], []
    for k, (first, second) in enumerate(pairwise(views)):
        _, ia, ib = np.intersect1d(m.point[first], m.point[second], return_indices=True)
        a.append(first[ia])
        b.append(second[ib])
        pair.append(np.full(len(ia), k))
    dt = np.diff(m.t[m.eye == 0])
    rows_a, rows_b = np.concatenate(a), np.concatenate(b)
    of_pair = np.concatenate(pair)
    return Matches(bearing[rows_a], bearing[rows_b], of_pair, m.point[rows_a], dt, f)


@dataclass(frozen=True, slots=True)
class Course:
    """Direction of travel (3,), unit, camera axes, and turns (P, 3): rotation vectors of R_a_b.

    a: earlier, b: later keyframe of each pair.
    """

    direction: Float
    turns: Float

    def path(self, steps: Float) -> Float:
        """T_c_s (P + 1, 4, 4) of a car that moves by signed steps (P,)."""
        T = [np.eye(4)]
        for w, step in zip(self.turns, steps, strict=True):
            chord = step * (se3.so3_exp(w / 2) @ self.direction)
            T.append(T[-1] @ se3.compose(se3.so3_exp(w), chord))
        return np.asarray(se3.inverse(np.stack(T)))


def courses(m: Matches, remembered: Float | None) -> list[Course]:
    """Courses that may be right: from the remembered direction of travel, or from any.

    remembered: (3,) unit vector, camera axes; None: searched from SEARCHED_DEG. Then a course far
    from straight ahead comes first if it fits clearly better, and the one ahead is kept.
    """
    if remembered is not None:
        return [_fitted(m, remembered, REMEMBERED_SIGMA_RAD)[1]]
    angles = np.radians(SEARCHED_DEG)
    starts = np.stack([np.sin(angles), np.zeros_like(angles), np.cos(angles)], 1)
    tried = [_fitted(m, start, DIRECTION_SIGMA_RAD) for start in starts]
    cost, ahead = tried[0]
    aside = [t for t in tried[1:] if t[1].direction[2] > MOST_ASIDE]
    best = min(aside, key=lambda t: t[0], default=tried[0])
    return [best[1], ahead] if best[0] < BETTER * cost else [ahead]


def _fitted(m: Matches, start: Float, sigma_rad: float) -> tuple[float, Course]:
    """Robust cost and course, from one start with a prior of this sigma on the direction."""
    found = directed_turns(m, start, sigma_rad)
    basis = np.linalg.svd(found.direction[None])[2][1:]
    across = _residuals(m, found.direction, basis, found.turns)[0]
    return float(np.log1p((across / EPIPOLAR_PX) ** 2).sum()), found


def directed_turns(m: Matches, start: Float, sigma_rad: float) -> Course:
    """The course by Gauss-Newton on the epipolar residuals, from a direction `start`.

    sigma_rad: of the start. On an arc, the chord from a to b points in the direction of travel that
    the car has half way through the rotation.
    """
    P = len(m.dt)
    direction, turns = start, np.zeros((P, 3))
    by_pair = grouped(m.pair)
    # unknowns of each pair: the direction, and its own turn
    rows = np.c_[
        np.tile([0, 1], (len(by_pair.keys), 1)), 2 + 3 * by_pair.keys[:, None] + np.arange(3)
    ]
    for k in range(ITERATIONS):
        scale_px = max(EPIPOLAR_PX, FIRST_PX * NARROWING**k)
        basis = np.linalg.svd(direction[None])[2][1:]
        across, along, J_d, J_w, J_along = _residuals(m, direction, basis, turns)
        sine = _normal((se3.so3_exp(turns / 2) @ direction)[m.pair], m.a)[1]
        w_across = 1 / (1 + (across / scale_px) ** 2) / EPIPOLAR_PX**2
        w_across /= 1 + (FIRST_RAD * NARROWING**k / sine) ** 2
        w_along = FAR_WEIGHT / (1 + (across**2 + along**2) / FAR_PX**2) ** 2 / FAR_PX**2
        H, g = np.zeros((2 + 3 * P, 2 + 3 * P)), np.zeros(2 + 3 * P)
        _add(H, g, rows, by_pair, np.concatenate([J_d, J_w], 1), across, w_across)
        _add(H, g, rows[:, 2:], by_pair, J_along, along, w_along)
        H[:2, :2] += np.eye(2) / sigma_rad**2
        g[:2] += basis @ (direction - start) / sigma_rad**2
        H += np.eye(len(H)) * 1e-3  # a pair that shares nothing keeps its turn
        step = np.linalg.solve(H, -g)
        direction = direction + step[:2] @ basis
        direction = direction / np.linalg.norm(direction)
        turn = np.asarray(step[2:].reshape(P, 3))
        turns = se3.so3_log(se3.so3_exp(turn) @ se3.so3_exp(turns))
        if np.abs(step).max() < 1e-6 and scale_px == EPIPOLAR_PX:
            break
    # both ends of the axis fit alike; the camera looks ahead rather than back
    return Course(direction if direction[2] > 0 else -direction, np.asarray(turns))


def _add(
    H: Float, g: Float, rows: Int, by_pair: Groups, J: Float, residual: Float, weight: Float
) -> None:
    """Add weighted residuals (n,), with derivatives J (n, k), to normal equations H, g.

    rows: (G, k) unknowns of each pair of `by_pair`.
    """
    joined = np.concatenate([J, residual[:, None]], 1).T
    sums = by_pair.sum(joined[:, None] * (weight * J.T))
    np.add.at(H, (rows[:, :, None], rows[:, None]), sums[:-1].transpose(2, 0, 1))
    np.add.at(g, rows, sums[-1].T)


def _residuals(
    m: Matches, direction: Float, basis: Float, turns: Float
) -> tuple[Float, Float, Float, Float, Float]:
    """Motion of each match across and along the direction of travel (n,) [px], and derivatives.

    After the rotations `turns` (P, 3) are removed. basis: (2, 3) orthogonal to the direction. The
    derivatives: of the first by the direction's two angles (n, 2) and by the rotation (n, 3), of
    the second by the rotation (n, 3).
    """
    moved = (se3.so3_exp(turns)[m.pair] @ m.b[..., None])[..., 0]
    half = se3.so3_exp(turns / 2)
    axis = (half @ direction)[m.pair]
    normal, sine = _normal(axis, m.a)
    away = np.cross(normal, m.a)
    across, along = m.f * (normal * moved).sum(1), m.f * ((moved - m.a) * away).sum(1)
    # the normal depends on the rotation too: the axis is the direction of travel, rotated by half
    in_plane = moved - normal * (across / m.f)[:, None]
    by_axis = m.f * np.cross(m.a, in_plane) / sine[:, None]
    J_d = np.einsum("ni,nij->nj", by_axis, (half @ basis.T)[m.pair])
    J_w = m.f * np.cross(moved, normal) + np.cross(axis, by_axis) / 2
    return across, along, J_d, J_w, m.f * np.cross(moved, away)


def _normal(axis: Float, a: Float) -> tuple[Float, Float]:
    """Unit normals (n, 3) of the planes of rays a (n, 3) and axis (n, 3), sine of their angle (n,).

    axis: direction of the baseline. The sine is at least NEAREST_RAD.
    """
    normal = np.cross(axis, a)
    sine = np.maximum(np.linalg.norm(normal, axis=1), NEAREST_RAD)
    return normal / sine[:, None], sine


def signed_steps(m: Matches, along: Course) -> Float:
    """Lengths (P,) of the steps along the direction of travel, negative backwards; median one.

    A point whose angle to the direction grows from u to v over a step s is at the distance s sin(v)
    / sin(v - u) before it and s sin(u) / sin(v - u) after it. At a keyframe between two steps the
    distance after the first equals that before the second: one homogeneous linear equation in the
    steps. Their weighted least-squares solution is an eigenvector, with the noise of both sides as
    the metric (Taubin, "Estimation of Planar Curves, Surfaces, and Nonplanar Space Curves", PAMI
    1991).
    """
    P, turns = len(m.dt), along.turns
    moved = (se3.so3_exp(turns)[m.pair] @ m.b[..., None])[..., 0]
    axis = (se3.so3_exp(turns / 2) @ along.direction)[m.pair]
    normal, sin_u = _normal(axis, m.a)
    grown = ((moved - m.a) * np.cross(normal, m.a)).sum(1)
    sin_v = np.maximum(np.linalg.norm(np.cross(axis, moved), axis=1), NEAREST_RAD)
    # angles between points and the direction of travel grow, unless the step is backwards
    clear = np.abs(grown) > FAR_PX / m.f
    votes = np.bincount(m.pair, np.sign(grown) * clear, P)
    way = np.where(votes < -REVERSE_SIGMAS * np.sqrt(np.bincount(m.pair, clear, P)), -1.0, 1.0)
    grown = grown * way[m.pair]
    before, after = grown / sin_v, grown / sin_u  # step over distance
    # rows of one point in a pair and in the next
    order = np.lexsort((m.pair, m.point))
    first, second = order[:-1], order[1:]
    linked = (m.point[first] == m.point[second]) & (m.pair[first] + 1 == m.pair[second])
    k = m.pair[first[linked]]
    i, j = after[first[linked]], before[second[linked]]
    noise = [1 / (m.f * sine) ** 2 for sine in (sin_u[first[linked]], sin_v[second[linked]])]
    rate = np.diff(np.diag(1 / m.dt), axis=0) / SPEED_SIGMA
    smooth = rate.T @ rate
    step = m.dt.copy()
    for _ in range(ITERATIONS):
        spread = step[k + 1] ** 2 * noise[0] + step[k] ** 2 * noise[1] + TINY
        error = (step[k + 1] * i - step[k] * j) ** 2 / spread
        weight = 1 / (1 + error / RATIO_SIGMAS**2) / spread
        A, B = smooth / float(np.median(np.abs(step / m.dt))) ** 2, np.eye(P)
        for row, column, value in (
            (k + 1, k + 1, i * i), (k, k, j * j), (k, k + 1, -i * j), (k + 1, k, -i * j)
        ):  # fmt: skip
            np.add.at(A, (row, column), weight * value)
        np.add.at(B, (k + 1, k + 1), weight * noise[0])
        np.add.at(B, (k, k), weight * noise[1])
        step = eigh(A, B, subset_by_index=[0, 0])[1][:, 0]
        # an eigenvector has neither length nor sign
        size = float(np.median(np.abs(step))) * (-1 if step.sum() < 0 else 1)
        step = step / size if size else np.ones(P)
    return np.asarray(way * step)
