"""Coloured point cloud of a sub-map, downsampled to one point per voxel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calm_edge.mapping.views import DenseViews, lift_all
from calm_edge.types import Bytes, Float32, Int

# 21 bits per axis: +-2^20 voxels from the origin
HALF = 1 << 20
# odd 64-bit multipliers of multiplicative hashing, one per round of `first_of_each`
MULTIPLIERS = (0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9, 0x27D4EB2F165667C5)


def voxel_keys(points: NDArray[np.floating], voxel: float) -> Int:
    """Voxel index of each point, packed into one integer: (M, 3) -> (M,).

    voxel: edge, in the unit of points. Indices beyond +-2^20 are clamped.
    """
    key = np.zeros(len(points), np.int64)
    for axis in range(3):
        cell = np.floor(np.asarray(points[:, axis], np.float64) / voxel)
        key = key << 21 | (cell.clip(-HALF, HALF - 1).astype(np.int64) + HALF)
    return key


def first_of_each(keys: Int) -> Int:
    """Indices (U,) of the first occurrence of each distinct key (M,), unordered.

    Uses hashing, which is several times faster than np.unique. In each round a slot is taken by
    its first key, which settles all equal keys; keys that collide with another go to the next
    round, and to np.unique after the last one.
    """
    left = np.arange(len(keys))
    bits = max(8, len(keys).bit_length() + 1)
    holder = np.empty(1 << bits, np.int64)
    found = []
    for multiplier in MULTIPLIERS:
        own = keys[left]
        slot = (own.view(np.uint64) * np.uint64(multiplier)) >> np.uint64(64 - bits)
        # numpy keeps the last of several assignments to a slot, hence the reversed order
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
    """Points (P, 3), sub-map frame, world units, and colours (P, 3) of the usable pixels.

    color: (N, h, w, 3). Per voxel the pixel with the smallest depth is kept, since depth errors
    grow with depth. If more than `most` points remain, a random subset of that size is taken.
    """
    pixel, points, depth = lift_all(views)
    # quantised to 16 bits, for which numpy's stable sort is a radix sort
    step = np.float32(65535 / depth.max(initial=1e-6))
    nearest_first = np.argsort((depth * step).astype(np.uint16), kind="stable")
    keys = voxel_keys(points, voxel)[nearest_first]
    keep = nearest_first[first_of_each(keys)]
    if len(keep) > most:
        keep = rng.choice(np.sort(keep), most, replace=False)
    keep = np.sort(keep)
    return points[keep].astype(np.float32), color.reshape(-1, 3)[pixel[keep]]
