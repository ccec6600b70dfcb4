"""Poses that a model with a wrong K predicts: those with the least epipolar error under it.

Each primary view is solved relative to the previous one, and a loop view relative to the view that
shares most points with it. Baseline lengths follow from depths of points that neighbouring pairs
share. Each assistant view is then solved against three primary views at once.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bench.scripted import epipolar
from bench.scripted.landmarks import Bool, Sightings
from calm_edge.backbones.base import BackboneError
from calm_edge.geometry import se3
from calm_edge.types import Float, Int
from device.frame import Eye

# Matches of each pair of primary views, and of each of the three pairs of an assistant view.
MATCHES, _MATCHES_OF_THREE = 160, 80
_MIN_MATCHES = 12
# An assistant view is solved against three primary views this number of views apart. Except at the
# ends of the window the middle one is that nearest in time.
_REACH = 2
# Minimum baseline of a pair, world units.
_MIN_STEP = 0.02


class _Pairs(NamedTuple):
    """Pairs of views a and b, by index.

    parent: index of an earlier pair with a view in common; the length of a pair's baseline |t_b_a|
    is measured relative to that of its parent.
    """

    a: Int
    b: Int
    parent: Int


def poses(
    rays: Float, focals: Float, sightings: Sightings, T_w_c: Float, eyes: Int, t_ns: Int, n: int
) -> Float:
    """Find T_s_c (N, 4, 4) that minimise the epipolar error of the sightings under a wrong K.

    rays: (N, M, 3) pixels back-projected by the wrong K. focals: (N, 2) px of it. T_w_c: true
    poses, as initial values and for the length of the path. n: number of leading primary views.
    Raises BackboneError.
    """
    if n < 2:
        raise BackboneError("scripted: a batch needs at least 2 primary frames")
    pairs = _pairs(sightings, T_w_c, eyes, t_ns, n)
    T_b_a = se3.inverse(T_w_c[pairs.b]) @ T_w_c[pairs.a]
    true_step = np.linalg.norm(T_b_a[:, :3, 3], axis=1)
    if true_step.min() < _MIN_STEP:
        raise BackboneError("scripted: two frames to be matched have the same position")
    solved = epipolar.solve(T_b_a, _matches(pairs.a, pairs.b, rays, focals, sightings))
    ratio = _ratios(solved, pairs, rays, sightings)
    length = np.ones(len(ratio))
    for k in range(1, len(length)):
        length[k] = length[pairs.parent[k]] * ratio[k]
    steps = slice(0, n - 1)
    length *= true_step[steps].sum() / length[steps].sum()
    solved[:, :3, 3] *= length[:, None]
    T = np.tile(np.eye(4), (len(eyes), 1, 1))
    for a, b, T_a_b in zip(pairs.a, pairs.b, se3.inverse(solved), strict=True):
        T[b] = T[a] @ T_a_b
    return _with_assistants(T, n, rays, focals, sightings, eyes, t_ns)


def n_primary(eyes: Int, loop: bool) -> int:
    """Number of leading primary keyframes, without the trailing loop keyframe."""
    return int(np.sum(eyes == Eye.PRIMARY)) - loop


def _pairs(sightings: Sightings, T_w_c: Float, eyes: Int, t_ns: Int, n: int) -> _Pairs:
    a, b = list(range(n - 1)), list(range(1, n))
    parent = [max(k - 1, 0) for k in range(n - 1)]
    for view in range(n, len(eyes)):
        shared = (sightings.seen[:n] & sightings.seen[view]).sum(1)
        apart = np.linalg.norm(T_w_c[:n, :3, 3] - T_w_c[view, :3, 3], axis=1)
        if eyes[view] == Eye.ASSISTANT:
            near = int(np.argmin(np.abs(t_ns[:n] - t_ns[view])))
        else:
            near = int(np.argmax(np.where(apart > _MIN_STEP, shared, -1)))
        a.append(near)
        b.append(view)
        parent.append(min(near, n - 2))
    return _Pairs(np.array(a), np.array(b), np.array(parent))


def _with_assistants(
    T: Float, n: int, rays: Float, focals: Float, sightings: Sightings, eyes: Int, t_ns: Int
) -> Float:
    """Solve each assistant view against several primary views at once, as multi-view models do.

    With two views alone, a wrong motion could compensate for a wrong ratio of their focals.
    """
    (views,) = np.nonzero(eyes == Eye.ASSISTANT)
    if not len(views):
        return T
    near = np.argmin(np.abs(t_ns[:n] - t_ns[views, None]), axis=1)
    first = np.clip(near - _REACH, 0, max(n - 1 - 2 * _REACH, 0))
    held = np.minimum(first[:, None] + _REACH * np.arange(3), n - 1)
    pairs = held.ravel(), np.repeat(views, 3)
    matches = _matches(*pairs, rays, focals, sightings, _MATCHES_OF_THREE)
    T[views] = se3.inverse(epipolar.resect(se3.inverse(T[views]), T[held], matches))
    return T


def _matches(
    a: Int, b: Int, rays: Float, focals: Float, sightings: Sightings, most: int = MATCHES
) -> epipolar.Matches:
    """Matches of P pairs of views a (P,), b (P,); raises BackboneError if a pair has too few."""
    index, weight = _some(sightings.seen[a] & sightings.seen[b], most)
    x_a, x_b = rays[a[:, None], index], rays[b[:, None], index]
    return epipolar.Matches(x_a, x_b, focals[a], focals[b], weight)


def _some(mask: Bool, most: int = MATCHES) -> tuple[Int, Float]:
    """Choose up to `most` of the true columns in each row of a mask (P, M), at random.

    Returns their indices and weights (P, C), C = min(most, M); weights are 0 where a row has fewer.
    Raises BackboneError if a row has too few.
    """
    if mask.sum(1).min() < _MIN_MATCHES:
        raise BackboneError("scripted: two neighbouring frames have too few common points")
    shuffle = np.random.default_rng(0).permutation(mask.shape[1])
    order = np.argsort(~mask[:, shuffle], axis=1, kind="stable")[:, :most]
    index = shuffle[order]
    return index, np.take_along_axis(mask, index, 1).astype(np.float64)


def _ratios(solved: Float, pairs: _Pairs, rays: Float, sightings: Sightings) -> Float:
    """Ratios (P,) of the baseline of each of P pairs to that of its parent, 1 for the first pair.

    They follow from the depths of common points in the view that both pairs contain.
    """
    child = np.arange(1, len(pairs.a))
    parent = pairs.parent[child]
    shared = pairs.a[child]
    # The next step along the path has the parent's view b as its view a. The parent of an assistant
    # or loop view is the step that starts at its view a, or else the last step.
    as_b = pairs.b[parent] == shared
    other = np.where(as_b, pairs.a[parent], pairs.b[parent])
    seen = sightings.seen
    index, weight = _some(seen[shared] & seen[other] & seen[pairs.b[child]])
    x = rays[shared[:, None], index]
    T_parent = np.where(as_b[:, None, None], se3.inverse(solved[parent]), solved[parent])
    near, parallax = epipolar.inverse_depth(solved[child], x, rays[pairs.b[child][:, None], index])
    far, parallax_parent = epipolar.inverse_depth(T_parent, x, rays[other[:, None], index])
    good = (near > 0) & (far > 0)
    weight *= np.where(good, np.minimum(parallax * near**2, parallax_parent * far**2), 0.0)
    if weight.sum(1).min() <= 0:
        raise BackboneError(
            "scripted: with this focal error no common point lies in front of both views"
        )
    log_ratio = np.log(np.where(good, near / np.where(good, far, 1.0), 1.0))
    return np.concatenate([[1.0], np.exp(epipolar.weighted_median(log_ratio, weight))])
