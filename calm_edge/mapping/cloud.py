"""Coloured points of a sub-map, and voxels that keep a cloud from repeating itself."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calm_edge.mapping.views import DenseViews, lift_all
from calm_edge.types import Bytes, Float32, Int

# 21 bits an axis: a million voxels to either side of the origin
HALF = 1 << 20
# odd 64-bit multipliers: one hash a round of `first_of_each`, by multiplication
MULTIPLIERS = (0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9, 0x27D4EB2F165667C5)


def voxel_keys(points: NDArray[np.floating], voxel: float) -> Int:
    """(M,) one integer a voxel of edge `voxel` (the points' unit), for points (M, 3).

    Points beyond a million voxels from the origin share the outermost ones.
    """
    key = np.zeros(len(points), np.int64)
    for axis in range(3):
        cell = np.floor(np.asarray(points[:, axis], np.float64) / voxel)
        key = key << 21 | (cell.clip(-HALF, HALF - 1).astype(np.int64) + HALF)
    return key


def first_of_each(keys: Int) -> Int:
    """(U,) index of the first occurrence of every distinct key (M,), in no particular order.

    By hashing: several times faster than sorting. In a round a slot goes to its first key, which
    settles all that share the key; keys that lost their slot to another go to the next round.
    """
    left = np.arange(len(keys))
    bits = max(8, len(keys).bit_length() + 1)
    holder = np.empty(1 << bits, np.int64)
    found = []
    for multiplier in MULTIPLIERS:
        own = keys[left]
        slot = (own.view(np.uint64) * np.uint64(multiplier)) >> np.uint64(64 - bits)
        # of several assignments to one slot the last one stays, so the first key comes last
        holder[slot[::-1]] = left[::-1]
        held = holder[slot]
        found.append(left[held == left])
        left = left[keys[held] != own]
        if not len(left):
            break
    found.append(left[np.unique(keys[left], return_index=True)[1]])
    return np.concatenate(found)


def submap_points(
    views: DenseViews, color: Bytes, voxel: float, most: int, rng: np.random.Generator
) -> tuple[Float32, Bytes]:
    """Points (P, 3), sub-map frame, world units, and colours (P, 3) of all usable pixels.

    color: (N, h, w, 3). Of the pixels in one voxel the one seen from nearest stays (depth errors
    grow with depth), to a 65,535th of the range; above `most` points a random subset stays.
    """
    pixel, points, depth = lift_all(views)
    # 16 bits are sorted by radix, in linear time
    step = np.float32(65535 / depth.max(initial=1e-6))
    nearest_first = np.argsort((depth * step).astype(np.uint16), kind="stable")
    keys = voxel_keys(points, voxel)[nearest_first]
    keep = nearest_first[first_of_each(keys)]
    if len(keep) > most:
        keep = rng.choice(np.sort(keep), most, replace=False)
    keep = np.sort(keep)
    return points[keep].astype(np.float32), color.reshape(-1, 3)[pixel[keep]]
