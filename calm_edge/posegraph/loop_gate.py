"""Which loops to believe, before the optimiser sees them (paper IV-D leaves this open).

Under the paper's loose variances any one loop closes at little cost, a false one as well: a
kernel alone cannot tell them apart. A loop is believed when usual drift could explain it, or
when severe drift could and other loops nearby call for the same correction; never against better
supported ones. That is the pairwise consistency of Mangelson et al., "Pairwise consistent
measurement set maximization for robust multi-robot map merging", 2018, kept to loops near each
other. A false loop that is no further off than drift is believed too: nothing tells it apart.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calm_edge.geometry import se3
from calm_edge.posegraph.noise import Noise
from calm_edge.posegraph.problem import Problem
from calm_edge.types import Float, Int

Bool = NDArray[np.bool_]

# chi-square with six degrees of freedom: one true loop in a thousand fails.
_GATE = 22.46
# Drift that goes on one way: of the distance, and rad a keyframe; for so many keyframes at most.
_DRIFT_SHARE, _DRIFT_RAD, _DRIFT_KEYFRAMES = 0.01, 0.0005, 100
# Severe drift is so many times worse: a focal length nobody has observed yet, for one.
_SEVERE = 10.0
# Loops that must back one which only severe drift explains: on a road of even bends two wrong
# ones agree by chance.
_BACKERS = 2
# Two loops can bear each other out where so many keyframes, at both ends together, part them.
_NEARBY = 80
# One sigma of a loop's own measurement: spacings, rad.
_LOOP_SIGMA = (0.2, 0.04)


def believed(problem: Problem, T_w_p: Float, noise: Noise) -> Bool:
    """(R,) of the edges that are `robust`, in their order, at the poses (N, 4, 4) so far."""
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
        # far along the way drift explains much: once others are backed, that is not enough
        possible = (usual[k] and (short[k] or support[k] or not (chosen & backed).any())) or (
            severe[k] and backed[k]
        )
        (others,) = np.nonzero(chosen)
        if possible and len(others):
            worse = np.where(backed[k] & backed[others] & ~nearby[k, others], _SEVERE, 1.0)
            possible = (apart_by(others, np.full(len(others), k), worse) < _GATE).all()
        chosen[k] = possible
    # support that was itself thrown out supports nothing
    return np.asarray(chosen & (usual | ((agree & chosen).sum(1) >= _BACKERS)))


class _Path:
    """Uncertainty of the motion along the keyframes, summed in the world from the first one."""

    def __init__(self, problem: Problem, T_w_p: Float, noise: Noise) -> None:
        edges, sigma = problem.edges, problem.sigma
        length = np.linalg.norm(np.diff(T_w_p[:, :3, 3], axis=0), axis=-1)
        n = len(length)
        # a third of a view's variance a step: window and both cameras average more than that away
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
        """(M, 6, 6) covariance of the motion between rows i and j, by from_world (M, 6, 6).

        worse: how many times the usual drift, one or (M,).
        Drift of n keyframes that all goes one way has n times the variance of independent ones.
        """
        low, high = np.minimum(i, j), np.maximum(i, j)
        steps = (np.minimum(high - low, _DRIFT_KEYFRAMES) * np.square(worse))[:, None, None]
        world = self._noise[high] - self._noise[low]
        world = world + steps * (self._drift[high] - self._drift[low])
        return np.asarray(from_world @ world @ np.swapaxes(from_world, -1, -2))


def _summed(to_world: Float, step: Float) -> Float:
    """(N, 6, 6): sums of steps (N - 1, 6, 6) up to each keyframe, in world axes."""
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
    """(M,) squared Mahalanobis distances of loops b from what loops a and the path predict."""
    (i_a, j_a, Z_a), (i_b, j_b, Z_b) = a, b
    T_ia_ib = se3.inverse(T_w_p[i_a]) @ T_w_p[i_b]
    predicted = se3.inverse(T_w_p[j_b]) @ T_w_p[j_a] @ Z_a @ T_ia_ib
    error = se3.log(se3.inverse(Z_b) @ predicted)
    from_a = se3.adjoint(se3.inverse(T_ia_ib))
    # the path at the far end moves in the world's axes, seen through the loop
    through_loop = se3.adjoint(se3.inverse(T_w_p[j_a] @ Z_a @ T_ia_ib))
    covariance = (
        path.between(i_a, i_b, se3.adjoint(se3.inverse(T_w_p[i_b])), worse)
        + path.between(j_a, j_b, through_loop, worse)
        + from_a @ loop @ np.swapaxes(from_a, -1, -2)
        + loop
    )
    return _mahalanobis(error, covariance)


def _mahalanobis(error: Float, covariance: Float) -> Float:
    """(M,) squared, of errors (M, 6) under covariances (M, 6, 6)."""
    solved = np.linalg.solve(covariance, error[..., None])[..., 0]
    return np.asarray((error * solved).sum(-1))
