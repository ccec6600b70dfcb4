"""SL(4) alignment of a sub-map with its predecessor by a homography, as in VGGT-SLAM.

Maggio et al., "VGGT-SLAM: Dense RGB SLAM Optimized on the SL(4) Manifold", 2025: 4x4 homographies
of determinant one from five-point samples; poses by decomposing the transformed projection
matrices.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bench.baselines.overlap import BaselineError, Correspondences
from calm_edge.types import Float, Submap

SAMPLES = 300
# Published value, for a scene whose points have a mean distance of one from its origin.
INLIER_DISTANCE = 0.01
SEED = 0
# Random subsets, for speed: largest number of points on which a sample is scored, and to which the
# homography is fitted.
_SCORED, _FITTED = 500, 1000
_REFITS = 2
# With a smaller ratio of the 15th of the 16 singular values to the largest, more than one
# homography fits.
_OPEN = 1e-7


def place(previous: Submap, new: Submap, matches: Correspondences) -> Float:
    """Estimate T_previous_new (4, 4), det 1, between raw homogeneous points.

    Deterministic: the random samples are seeded. Raises BaselineError.
    """
    matches = matches.finite()
    n = len(matches.weight)
    if n < 5:
        raise BaselineError(f"{n} common points; SL(4) needs 5")
    N_target, N_source = _normalisation(matches.previous), _normalisation(matches.new)
    target = homogeneous(matches.previous) @ N_target.T
    source = homogeneous(matches.new) @ N_source.T
    limit = INLIER_DISTANCE * matches.unit() * N_target[0, 0]
    rng = np.random.default_rng(SEED)
    with np.errstate(all="ignore"):
        H = _best_sample(source, target, limit, rng)
        for _ in range(_REFITS):
            (inlier,) = np.nonzero(_distance(H[None], source, target)[0] <= limit)
            if len(inlier) < 5:
                raise BaselineError(f"{len(inlier)} points agree on a homography; SL(4) needs 5")
            some = rng.permutation(inlier)[:_FITTED]
            H = _direct_linear(source[some], target[some])
        H = special(np.linalg.inv(N_target) @ H @ N_source)
    w = homogeneous(matches.new) @ H[3]
    return -H if np.median(w) < 0 else H


def poses(T_w_s: Float, submap: Submap) -> Float:
    """Decompose the projections K [R | t] T_w_s^-1 of all views into T_w_c (N, 4, 4).

    K [R | t]: projection of a view in its sub-map. The K of the result, which a homography changes,
    is not used. Raises BaselineError.
    """
    with np.errstate(all="ignore"):
        try:
            T_c_w = np.linalg.inv(T_w_s @ submap.T_s_c_raw)
            P = np.stack([camera.matrix for camera in submap.cameras_raw]) @ T_c_w[:, :3]
            M = P[:, :, :3]
            centre = -np.linalg.solve(M, P[:, :, 3:])[..., 0]
            R_c_w = _rotation(M * np.sign(np.linalg.det(M))[:, None, None])
        except np.linalg.LinAlgError:
            raise BaselineError("a transformed projection matrix cannot be decomposed") from None
    T = np.tile(np.eye(4), (len(P), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = np.swapaxes(R_c_w, 1, 2), centre
    if not np.isfinite(T).all():
        raise BaselineError("a transformed projection matrix is not finite")
    return T


def special(H: Float) -> Float:
    """Scale H (4, 4) to det 1; raises BaselineError for a reflection or non-finite values."""
    determinant = np.linalg.det(H) if np.isfinite(H).all() else np.nan
    if not determinant > 0:
        raise BaselineError(f"the homography's determinant is {determinant:.3g}, not above 0")
    H = H / determinant**0.25
    if not np.isfinite(H).all():
        raise BaselineError("the homography is not finite")
    return np.asarray(H)


def homogeneous(p: Float) -> Float:
    """Append 1 to points (N, 3): (N, 4)."""
    return np.column_stack([p, np.ones(len(p))])


def _normalisation(p: Float) -> Float:
    """Similarity (4, 4) that moves the mean of points (N, 3) to 0, their mean norm to sqrt(3)."""
    centre = p.mean(0)
    distance = float(np.linalg.norm(p - centre, axis=1).mean())
    if distance == 0:
        raise BaselineError("the common points coincide")
    N = np.diag([np.sqrt(3) / distance] * 3 + [1.0])
    N[:3, 3] = -N[0, 0] * centre
    return N


def _best_sample(source: Float, target: Float, limit: float, rng: np.random.Generator) -> Float:
    """Homography (4, 4) from the five-point sample with the most inliers (RANSAC).

    source, target: (N, 4) homogeneous points. limit: largest distance of an inlier.
    """
    rows = rng.integers(0, len(source), (SAMPLES, 5))
    B, B_target = _basis(source[rows]), _basis(target[rows])
    volume, volume_target = np.linalg.det(B), np.linalg.det(B_target)
    usable = np.isfinite(B).all((1, 2)) & np.isfinite(B_target).all((1, 2))
    # discard degenerate (coplanar or repeated points) and mirrored samples
    usable &= (np.abs(volume) > 1e-9) & (np.abs(volume_target) > 1e-9)
    usable &= volume * volume_target > 0
    if not usable.any():
        raise BaselineError("the common points are planar or mirrored; SL(4) needs depth")
    H = B_target[usable] @ np.linalg.inv(B[usable])
    scored = rng.permutation(len(source))[:_SCORED]
    agree = (_distance(H, source[scored], target[scored]) <= limit).sum(1)
    return np.asarray(H[np.argmax(agree)])


def _basis(points: Float) -> Float:
    """Matrices (B, 4, 4) that map the four unit vectors and their sum to five points (B, 5, 4).

    Five homogeneous points in each of B samples; NaN where they are coplanar.
    """
    corners = np.swapaxes(points[:, :4], 1, 2)
    flat = np.abs(np.linalg.det(corners)) < 1e-9
    corners = np.where(flat[:, None, None], np.eye(4), corners)
    weight = np.linalg.solve(corners, points[:, 4, :, None])
    basis = corners * np.swapaxes(weight, 1, 2)
    return np.where(flat[:, None, None], np.nan, basis)


def _distance(H: Float, source: Float, target: Float) -> Float:
    """Distances (B, N) of H source from target for B homographies H (B, 4, 4); NaN at infinity.

    source, target: (N, 4) homogeneous points.
    """
    moved = source @ np.swapaxes(H, 1, 2)
    return np.asarray(
        np.linalg.norm(moved[..., :3] / moved[..., 3:] - target[None, :, :3], axis=-1)
    )


def _direct_linear(source: Float, target: Float) -> Float:
    """Fit H (4, 4) to homogeneous points (N, 4) by the direct linear transform.

    Minimises the squares of target_w (H source)_i - target_i (H source)_w.
    """
    n = len(source)
    A = np.zeros((n, 3, 4, 4))
    for i in range(3):
        A[:, i, i] = source
        A[:, i, 3] = -target[:, i, None] * source
    # five points are one row short of the 16 columns: the last row of Vt is then their null space
    _, singular, Vt = np.linalg.svd(A.reshape(3 * n, 16), full_matrices=n == 5)
    if singular[14] <= _OPEN * singular[0]:
        raise BaselineError("the common points do not determine the homography; SL(4) needs depth")
    return np.asarray(Vt[-1].reshape(4, 4))


def _rotation(M: Float) -> NDArray[np.float64]:
    """Rotations R (N, 3, 3) of M = K R, K upper triangular with a positive diagonal, det M > 0."""
    Q, R = np.linalg.qr(np.swapaxes(M[:, ::-1], 1, 2))
    Q = Q * np.where(np.diagonal(R, axis1=1, axis2=2) < 0, -1.0, 1.0)[:, None]
    return np.asarray(np.swapaxes(Q, 1, 2)[:, ::-1])
