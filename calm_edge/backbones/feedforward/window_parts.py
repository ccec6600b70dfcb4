"""Split a window that exceeds the network's maximum into overlapping parts, and stitch these.

The scale between two parts comes from the depth of their common views (thousands of pixels, more
reliable than the short baselines), rotation and translation from the poses of these views.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from calm_edge.backbones.base import BackboneError
from calm_edge.backbones.feedforward.decode.decoder import Decoded
from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera
from calm_edge.geometry.similarity import Similarity
from calm_edge.types import Float, Float32, Int

# Share of a part's views in common with its neighbour: more is more accurate but takes more runs.
OVERLAP_SHARE = 1 / 3
MIN_SHARED_PIXELS = 16


def overlap(cap: int) -> int:
    """Number of common views of neighbouring parts of at most `cap` >= 2 views."""
    return min(max(2, round(cap * OVERLAP_SHARE)), cap - 1)


def split(t_ns: Int, cap: int) -> list[Int]:
    """Split views by time into parts of at most `cap` >= 2: batch indices, part of view 0 first.

    t_ns: (N,) stamps of both cameras, so that each part has views of both. The last part is as
    long as the others, with a larger overlap. Each part overlaps one before it.
    """
    order = np.argsort(t_ns, kind="stable")
    n, step = len(order), cap - overlap(cap)
    if n <= cap:
        return [order]
    starts = [*range(0, n - cap, step), n - cap]
    parts = [np.asarray(order[start : start + cap]) for start in starts]
    first = next(i for i, part in enumerate(parts) if 0 in part)
    return parts[first:] + parts[:first][::-1]


def around(t_ns: Int, view: int, cap: int) -> Int:
    """Batch indices of `view`, then of the cap - 2 other views nearest to it in time."""
    near = np.argsort(np.abs(t_ns - t_ns[view]), kind="stable")
    near = np.concatenate([[view], near[near != view]])
    return np.asarray(near[: cap - 1], np.int64)


def stitch(n: int, parts: Sequence[Int], solved: Sequence[Decoded]) -> Decoded:
    """Merge the results of parts into one for N views, in the frame of view 0.

    parts: batch indices of each part, overlapping with earlier ones. A view keeps the result of
    its first part. Raises BackboneError if common views have no common depth.
    """
    first = solved[0]
    shape = first.depth.shape[1:]
    cameras: dict[int, Camera] = {}
    T = np.zeros((n, 4, 4))
    depth = np.zeros((n, *shape), np.float32)
    strength = np.full((n, *shape), -np.inf, np.float32)
    placed = np.zeros(n, np.bool_)
    for part, own in zip(parts, solved, strict=True):
        if own.depth.shape[1:] != shape:
            raise BackboneError("the parts of a window have depth maps of different sizes")
        common = placed[part]
        whole_from_part = Similarity(1.0, np.eye(3), np.zeros(3))
        if placed.any():
            known = part[common]
            there = _Shared(T[known], depth[known], strength[known])
            here = _Shared(own.T_s_c[common], own.depth[common], own.strength[common])
            whole_from_part = _between(here, there)
        new = part[~common]
        cameras |= {i: own.cameras[k] for k, i in enumerate(part.tolist()) if not placed[i]}
        T[new] = whole_from_part.poses(own.T_s_c[~common])
        depth[new] = own.depth[~common] * np.float32(whole_from_part.scale)
        strength[new] = own.strength[~common]
        placed[new] = True
    T = se3.inverse(T[0]) @ T
    T[0] = np.eye(4)
    return Decoded(tuple(cameras[i] for i in range(n)), T, depth, strength)


class _Shared(NamedTuple):
    """Results for the views that a part has in common with another one; fields as in Decoded."""

    T_s_c: Float
    depth: Float32
    strength: Float32


def _between(here: _Shared, there: _Shared) -> Similarity:
    """Similarity here -> there from the same views in both. Raises BackboneError."""
    both = (here.depth > 0) & (there.depth > 0)
    if both.sum() < MIN_SHARED_PIXELS:
        raise BackboneError("two parts of the window share no depth and cannot be stitched")
    # the more confident half of the pixels, by the new part's confidence
    both &= here.strength >= np.median(here.strength[both])
    scale = float(np.exp(np.median(np.log(there.depth[both]) - np.log(here.depth[both]))))
    R_there, R_here = there.T_s_c[:, :3, :3], here.T_s_c[:, :3, :3]
    turns = se3.compose(R_there @ R_here.swapaxes(1, 2), np.zeros(3))
    R = se3.mean(turns)[:3, :3]
    t = (there.T_s_c[:, :3, 3] - scale * (here.T_s_c[:, :3, 3] @ R.T)).mean(0)
    return Similarity(scale, R, t)
