"""Outlier rejection for loop closures before optimisation (the paper has none in IV-D).

With the paper's loose variances a single false loop closes at a low cost, so a robust kernel
cannot reject it. A loop is accepted if typical drift explains it, or if severe drift does and
enough loops nearby agree with it, and only if it agrees with all loops accepted before it (those
with more support come first). The agreement test is the pairwise consistency of Mangelson et al.,
"Pairwise consistent measurement set maximization for robust multi-robot map merging", 2018,
between nearby loops. A false loop within typical drift cannot be recognised and is accepted.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calm_edge.geometry import se3
from calm_edge.posegraph.noise import Noise
from calm_edge.posegraph.problem import Problem
from calm_edge.types import Float, Int

Bool = NDArray[np.bool_]

# 99.9 % quantile of chi-square with six degrees of freedom.
_GATE = 22.46
# Typical systematic drift: share of the distance, rad per keyframe, and the number of keyframes
# over which its direction persists.
_DRIFT_SHARE, _DRIFT_RAD, _DRIFT_KEYFRAMES = 0.01, 0.0005, 100
# Ratio of severe to typical drift; severe drift occurs before turns make the focal observable.
_SEVERE = 10.0
# Agreeing loops required where only severe drift explains a loop. One is too few: on a road with
# similar bends two false loops can agree by chance.
_BACKERS = 2
# Two loops are nearby when their first and their second keyframes differ by at most this in sum.
_NEARBY = 80
# Sigma of a loop measurement: map units, rad.
_LOOP_SIGMA = (0.2, 0.04)


def accepted_loops(problem: Problem, T_w_p: Float, noise: Noise) -> Bool:
    """Whether each loop (R,) is accepted, in the order of the edges that are `robust`.

    T_w_p: (N, 4, 4) current keyframe poses. noise: of the odometry edges.
    """
    edges = problem.edges
    (at,) = np.nonzero(edges.robust)
    if not len(at):
        return np.zeros(0, bool)
    i, j, Z = edges.i[at], edges.j[at], edges.T_j_i[at]
    path = _Path(problem, T_w_p, noise)
    loop = np.diag(np.repeat(np.square(_LOOP_SIGMA) * [problem.spacing**2, 1.0], 3))
    apart = np.abs(i[:, None] - i) + np.abs(j[:, None] - j)
    nearby = (apart <= _NEARBY) & ~np.eye(len(at), dtype=bool)

    def apart_by(a: Int, b: Int, worse: float | Float) -> Float:
        return _disagreement(T_w_p, path, (i[a], j[a], Z[a]), (i[b], j[b], Z[b]), loop, worse)

    agree = np.zeros(nearby.shape, bool)
    a, b = np.nonzero(np.tril(nearby))
    agree[a, b] = agree[b, a] = apart_by(a, b, 1.0) < _GATE
    error = se3.log(se3.inverse(T_w_p[j] @ Z) @ T_w_p[i])
    from_world = se3.adjoint(se3.inverse(T_w_p[i]))
    own = _mahalanobis(error, path.between(i, j, from_world, 1.0) + loop)
    usual = own < _GATE
    severe = _mahalanobis(error, path.between(i, j, from_world, _SEVERE) + loop) < _GATE
    support = agree.sum(1)
    backed = support >= _BACKERS
    short = np.abs(i - j) <= _DRIFT_KEYFRAMES
    chosen = np.zeros(len(at), bool)
    for k in np.lexsort((own, -support)):
        # Over a long path typical drift is so large that almost any loop passes the gate. Then
        # require an agreeing loop, as soon as some accepted loop has enough of them.
        possible = (usual[k] and (short[k] or support[k] or not (chosen & backed).any())) or (
            severe[k] and backed[k]
        )
        (others,) = np.nonzero(chosen)
        if possible and len(others):
            worse = np.where(backed[k] & backed[others] & ~nearby[k, others], _SEVERE, 1.0)
            possible = (apart_by(others, np.full(len(others), k), worse) < _GATE).all()
        chosen[k] = possible
    # with severe drift, only agreement with accepted loops counts
    return np.asarray(chosen & (usual | ((agree & chosen).sum(1) >= _BACKERS)))


class _Path:
    """Covariance of the odometry, accumulated from the first keyframe to each, in world axes."""

    def __init__(self, problem: Problem, T_w_p: Float, noise: Noise) -> None:
        edges, sigma = problem.edges, problem.sigma
        length = np.linalg.norm(np.diff(T_w_p[:, :3, 3], axis=0), axis=-1)
        n = len(length)
        # A third of one view's variance per step, an upper bound: edges to several preceding
        # keyframes, and both cameras, average the error to less than that.
        step = np.tile(noise.view_covariance() / 3, (n, 1, 1))
        bridge = ~edges.robust & (edges.submap < 0)
        last = np.maximum(edges.i, edges.j)[bridge] - 1
        step[last] += np.diag(sigma**2) / edges.weight[bridge, None, None]
        drift = np.zeros((n, 6))
        drift[:, :3], drift[:, 3:] = (_DRIFT_SHARE * length[:, None]) ** 2, _DRIFT_RAD**2
        to_world = se3.adjoint(T_w_p[1:])
        self._noise = _summed(to_world, step)
        self._drift = _summed(to_world, drift[:, :, None] * np.eye(6))

    def between(self, i: Int, j: Int, from_world: Float, worse: float | Float) -> Float:
        """Covariance (M, 6, 6) of the relative motion between state rows i and j (M,).

        from_world: (M, 6, 6) adjoints from world axes to those of the result. worse: factor on the
        typical drift, scalar or (M,). Fully correlated drift over n keyframes has n times the
        variance of independent drift.
        """
        low, high = np.minimum(i, j), np.maximum(i, j)
        steps = (np.minimum(high - low, _DRIFT_KEYFRAMES) * np.square(worse))[:, None, None]
        world = self._noise[high] - self._noise[low]
        world = world + steps * (self._drift[high] - self._drift[low])
        return np.asarray(from_world @ world @ np.swapaxes(from_world, -1, -2))


def _summed(to_world: Float, step: Float) -> Float:
    """Cumulative sums (N, 6, 6) of step covariances (N - 1, 6, 6), transformed to world axes."""
    moved = to_world @ step @ np.swapaxes(to_world, -1, -2)
    return np.concatenate([np.zeros((1, 6, 6)), np.cumsum(moved, 0)])


def _disagreement(
    T_w_p: Float,
    path: _Path,
    a: tuple[Int, Int, Float],
    b: tuple[Int, Int, Float],
    loop: Float,
    worse: float | Float,
) -> Float:
    """Squared Mahalanobis distances (M,) between loops b and their prediction from loops a.

    a, b: state rows i and j (M,) and measurement T_j_i (M, 4, 4). Loop a is carried to loop b
    along the path. loop: (6, 6) covariance of a loop measurement. worse: factor on the drift along
    the path.
    """
    (i_a, j_a, Z_a), (i_b, j_b, Z_b) = a, b
    T_ia_ib = se3.inverse(T_w_p[i_a]) @ T_w_p[i_b]
    predicted = se3.inverse(T_w_p[j_b]) @ T_w_p[j_a] @ Z_a @ T_ia_ib
    error = se3.log(se3.inverse(Z_b) @ predicted)
    from_a = se3.adjoint(se3.inverse(T_ia_ib))
    # adjoint from the world axes at keyframes j to the frame of the error, by way of loop a
    through_loop = se3.adjoint(se3.inverse(T_w_p[j_a] @ Z_a @ T_ia_ib))
    covariance = (
        path.between(i_a, i_b, se3.adjoint(se3.inverse(T_w_p[i_b])), worse)
        + path.between(j_a, j_b, through_loop, worse)
        + from_a @ loop @ np.swapaxes(from_a, -1, -2)
        + loop
    )
    return _mahalanobis(error, covariance)


def _mahalanobis(error: Float, covariance: Float) -> Float:
    """Squared Mahalanobis norms (M,) of errors (M, 6) under covariances (M, 6, 6)."""
    solved = np.linalg.solve(covariance, error[..., None])[..., 0]
    return np.asarray((error * solved).sum(-1))
