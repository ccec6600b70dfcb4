"""A window longer than a network takes: split in time with overlap, and stitched again.

Parts share views. Depth of these gives the scale between two parts (it is known at thousands of
pixels, where the distance of neighbouring views is hardly known at all), their poses the rest.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calm_edge.backbones.base import BackboneError
from calm_edge.backbones.feedforward.decode.decoder import Decoded
from calm_edge.geometry import se3
from calm_edge.geometry.similarity import Similarity
from calm_edge.types import Int

# Views that neighbouring parts share: more tie them better and cost more runs.
OVERLAP_SHARE = 1 / 3
MIN_SHARED_PIXELS = 16


def overlap(cap: int) -> int:
    """Views that neighbouring parts of at most `cap` >= 2 share."""
    return min(max(2, round(cap * OVERLAP_SHARE)), cap - 1)


def split(t_ns: Int, cap: int) -> list[Int]:
    """Batch indices of each part of at most `cap` >= 2 views, by time, the first view's part first.

    t_ns: (N,) stamps. Both eyes mix by their stamps, so every part has views of both. The last part
    is as long as the others and shares more instead.
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
    """Batch indices of the cap - 1 views nearest in time to a view, itself first."""
    near = np.argsort(np.abs(t_ns - t_ns[view]), kind="stable")
    near = np.concatenate([[view], near[near != view]])
    return np.asarray(near[: cap - 1], np.int64)


def stitch(n: int, parts: Sequence[Int], solved: Sequence[Decoded]) -> Decoded:
    """One answer for N views from each part's own; view 0 is the frame.

    parts: batch indices, each sharing views with those before it. A view keeps the answer of the
    first part that has it. Raises BackboneError where two parts share no depth.
    """
    first = solved[0]
    shape = first.depth.shape[1:]
    K, T = np.zeros((n, 3, 3)), np.zeros((n, 4, 4))
    depth = np.zeros((n, *shape), np.float32)
    strength = np.full((n, *shape), -np.inf, np.float32)
    placed = np.zeros(n, np.bool_)
    for part, own in zip(parts, solved, strict=True):
        if own.depth.shape[1:] != shape:
            raise BackboneError("the parts of a window have depth of unlike size")
        common = placed[part]
        whole_from_part = Similarity(1.0, np.eye(3), np.zeros(3))
        if placed.any():
            known = part[common]
            there = Decoded(K[known], T[known], depth[known], strength[known])
            here = Decoded(
                own.K[common], own.T_s_c[common], own.depth[common], own.strength[common]
            )
            whole_from_part = _between(here, there)
        new = part[~common]
        K[new] = own.K[~common]
        T[new] = whole_from_part.poses(own.T_s_c[~common])
        depth[new] = own.depth[~common] * np.float32(whole_from_part.scale)
        strength[new] = own.strength[~common]
        placed[new] = True
    T = se3.inverse(T[0]) @ T
    T[0] = np.eye(4)
    return Decoded(K, T, depth, strength)


def _between(here: Decoded, there: Decoded) -> Similarity:
    """here -> there, of the same views in both."""
    both = (here.depth > 0) & (there.depth > 0)
    if both.sum() < MIN_SHARED_PIXELS:
        raise BackboneError("two parts of the window share no depth: they cannot be joined")
    # the half that the new part is surer of
    both &= here.strength >= np.median(here.strength[both])
    scale = float(np.exp(np.median(np.log(there.depth[both]) - np.log(here.depth[both]))))
    R_there, R_here = there.T_s_c[:, :3, :3], here.T_s_c[:, :3, :3]
    turns = se3.compose(R_there @ R_here.swapaxes(1, 2), np.zeros(3))
    R = se3.mean(turns)[:3, :3]
    t = (there.T_s_c[:, :3, 3] - scale * (here.T_s_c[:, :3, 3] @ R.T)).mean(0)
    return Similarity(scale, R, t)
