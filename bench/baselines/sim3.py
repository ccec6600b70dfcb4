"""Sim(3) alignment of a sub-map with its predecessor, as in VGGT-Long.

Deng et al., "VGGT-Long: Chunk it, Loop it, Align it", 2025: iteratively reweighted least squares
with Huber weights on the points of the common pictures, weighted by confidence; Sim(3) loops.
"""

from __future__ import annotations

import numpy as np

from bench.baselines.overlap import BaselineError, Correspondences
from calm_edge.geometry.similarity import Similarity, align
from calm_edge.types import Float, Submap

ITERATIONS = 5
# Published value, for a scene whose points have a mean distance of one from its origin.
HUBER_DELTA = 0.1
# Huber's delta per median residual: the usual 1.345 sigmas (95 % efficiency) over 1.538 sigmas, the
# median length of a 3-D Gaussian vector.
_DELTA_PER_MEDIAN = 1.345 / 1.538
# If the ratio of the second largest to the largest extent of the points is smaller, they lie on a
# line, and the rotation about it is undetermined.
_LINE = 1e-6


def place(previous: Submap, new: Submap, matches: Correspondences) -> Float:
    """Estimate T_previous_new (4, 4) = [[scale R, t], [0, 1]] between raw frames.

    The scale is the ratio of the weighted spreads of both point sets, as published: unlike the
    least-squares scale it does not shrink with noise. Huber's delta is the published value, reduced
    if the median residual is small. Raises BaselineError.
    """
    matches = matches.finite()
    if len(matches.weight) < 3:
        raise BaselineError(f"{len(matches.weight)} common points; Sim(3) needs 3")
    largest = HUBER_DELTA * matches.unit()
    found = _fit(matches, matches.weight)
    for _ in range(ITERATIONS):
        residual = np.linalg.norm(found.points(matches.new) - matches.previous, axis=1)
        delta = min(largest, _DELTA_PER_MEDIAN * float(np.median(residual)))
        if delta <= np.finfo(float).eps * largest:
            break
        found = _fit(matches, matches.weight * delta / np.maximum(residual, delta))
    T = found.matrix()
    if not np.isfinite(T).all():
        raise BaselineError("the estimated similarity is not finite")
    return T


def poses(T_w_s: Float, submap: Submap) -> Float:
    """T_w_c (N, 4, 4) of every view of a sub-map placed by T_w_s (4, 4); raises BaselineError."""
    if not (np.isfinite(T_w_s).all() and np.linalg.det(T_w_s[:3, :3]) > 0):
        raise BaselineError("the optimised transform is not a similarity")
    return Similarity.from_matrix(T_w_s).poses(submap.T_s_c_raw)


def _fit(matches: Correspondences, weight: Float) -> Similarity:
    share = weight / weight.sum()
    target = matches.previous - share @ matches.previous
    source = matches.new - share @ matches.new
    extent = np.linalg.svd(np.sqrt(share)[:, None] * source, compute_uv=False)
    spread_target = float(np.sqrt(share @ (target**2).sum(1)))
    spread_source = float(np.linalg.norm(extent))
    if not (spread_target > 0 and extent[1] > _LINE * extent[0]):
        raise BaselineError("the common points lie on a line, which does not determine Sim(3)")
    if not (spread_source > 0 and np.isfinite(scale := spread_target / spread_source)):
        raise BaselineError("the common points all coincide")
    rigid = align(scale * matches.new, matches.previous, with_scale=False, weights=share)
    return Similarity(scale, rigid.R, rigid.t)
