"""Coloured points of a sub-map, and voxels that keep a cloud from repeating itself."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calm_edge.mapping.views import DenseViews, lift
from calm_edge.types import Bytes, Float32, Int

# 21 bits an axis: a million voxels to either side of the origin
HALF = 1 << 20


def voxel_keys(points: NDArray[np.floating], voxel: float) -> Int:
    """(M,) one integer a voxel of edge `voxel` (the points' unit), for points (M, 3).

    Points beyond a million voxels from the origin share the outermost ones.
    """
    cell = np.floor(np.asarray(points, np.float64) / voxel).clip(-HALF, HALF - 1).astype(np.int64)
    x, y, z = (cell + HALF).T
    return np.asarray((x << 42) | (y << 21) | z)


def submap_points(
    views: DenseViews, color: Bytes, voxel: float, most: int, rng: np.random.Generator
) -> tuple[Float32, Bytes]:
    """Points (P, 3), sub-map frame, world units, and colours (P, 3) of all usable pixels.

    color: (N, h, w, 3). Of the pixels in one voxel the one seen from nearest stays (depth errors
    grow with depth); above `most` points a random subset stays.
    """
    view, y, x = np.nonzero(views.usable)
    depth = 1 / views.inverse_depth[view, y, x]
    uv = views.to_image(view, np.stack([x, y], -1))
    points = lift(views, view, uv, depth)
    order = np.argsort(depth, kind="stable")
    first = np.unique(voxel_keys(points[order], voxel), return_index=True)[1]
    keep = order[first]
    if len(keep) > most:
        keep = rng.choice(keep, most, replace=False)
    keep = np.sort(keep)
    return points[keep].astype(np.float32), color[view[keep], y[keep], x[keep]]


class VoxelFilter:
    """Remembers the voxels already filled by earlier tiles: 8 bytes a voxel."""

    def __init__(self, voxel: float) -> None:
        self._voxel = voxel
        self._filled = np.empty(0, np.int64)

    def admit(self, points: NDArray[np.floating]) -> Int:
        """Ascending indices of points (M, 3) that are the first in their voxel; fills those."""
        keys, first = np.unique(voxel_keys(points, self._voxel), return_index=True)
        at = np.searchsorted(self._filled, keys)
        known = np.zeros(len(keys), bool)
        inside = at < len(self._filled)
        known[inside] = self._filled[at[inside]] == keys[inside]
        self._filled = np.insert(self._filled, at[~known], keys[~known])
        return np.sort(first[~known])
