"""Fusion of anchor positions over sub-maps, and local suppression (paper VI-C)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calm_edge.geometry import se3
from calm_edge.mapping.views import MappingError
from calm_edge.types import AnchorTable, Float, Int, Submap

# lower bound of the squared distance in the weight, world units^2
MIN_DISTANCE2 = 1e-6
# anchors processed at a time by `Fusion.active`
SLAB = 100_000
# rows by which the file grows
BLOCK = 1 << 16
# columns of a row of the file
WEIGHTED, WEIGHT, COUNT = slice(0, 3), 3, 4


def central_centre(submap: Submap) -> Float:
    """Optical centre (3,) of the central primary keyframe, sub-map frame, world units."""
    return np.asarray(submap.T_s_c[submap.n_primary // 2, :3, 3])


def weights(p_s: Float, centre_s: Float) -> Float:
    """Fusion weights (M,), 1 / |p - centre|^2, of points (M, 3), world units (paper VI-C.1).

    centre_s: (3,) optical centre of the sub-map's central primary keyframe.
    """
    return np.asarray(1 / np.maximum(((p_s - centre_s) ** 2).sum(-1), MIN_DISTANCE2))


class Fusion:
    """Incremental weighted mean of the world positions of all anchors, in a memory-mapped file.

    Row k, anchor k: sum of w p_w, sum of w, number of sub-maps. `add` touches only the rows of
    its anchors, so that its time and memory do not grow with the drive. distance_weight: False
    weighs all observations equally.
    """

    def __init__(self, path: Path, distance_weight: bool = True) -> None:
        """path: scratch file, overwritten; the caller removes it. Raises MappingError."""
        self._path = path
        self._distance_weight = distance_weight
        self._size = 0
        self._capacity = 0
        self.clear()

    def __len__(self) -> int:
        """Number of anchors: the largest id plus one."""
        return self._size

    def clear(self) -> None:
        """Remove all observations."""
        try:
            self._path.write_bytes(b"")
        except OSError as error:
            raise MappingError(
                f"{self._path}: cannot be written ({error.strerror}); check the disk"
            ) from None
        self._size = self._capacity = 0

    def add(self, rows: AnchorTable, submap: Submap) -> None:
        """Add observations of anchors by one sub-map, each anchor at most once (paper VI-C.1)."""
        if not len(rows.anchor):
            return
        self._size = max(self._size, int(rows.anchor.max()) + 1)
        w = np.ones(len(rows.anchor))
        if self._distance_weight:
            w = weights(rows.p_s, central_centre(submap))
        new = np.empty((len(w), 5))
        new[:, WEIGHTED] = w[:, None] * se3.transform(submap.T_w_s, rows.p_s)
        new[:, WEIGHT], new[:, COUNT] = w, 1
        with self._rows() as sums:
            sums[rows.anchor] += new

    def at(self, anchor: Int) -> tuple[Float, Int]:
        """Fused positions (M, 3), world units, and observation counts (M,) of anchor ids (M,)."""
        with self._rows() as sums:
            rows = np.asarray(sums[anchor])
        return rows[:, WEIGHTED] / rows[:, [WEIGHT]], rows[:, COUNT].astype(np.int64)

    def active(self, radius: float) -> NDArray[np.bool_]:
        """Mask (A,) of the anchors that are not suppressed (paper VI-C.2).

        radius: world units. Works in slabs along the longest axis of the map: memory is one slab
        and 25 bytes per anchor.
        """
        active = np.ones(self._size, bool)
        if not self._size:
            return active
        axis = int(np.argmax([np.ptp(self._along(axis)) for axis in range(3)]))
        along = self._along(axis)
        order = np.argsort(along)
        along = along[order]
        for start in range(0, len(order), SLAB):
            stop = min(start + SLAB, len(order))
            low, high = np.searchsorted(along, along[[start, stop - 1]] + [-2 * radius, 2 * radius])
            kept = suppress(*self.at(order[low:high]), radius)
            active[order[start:stop]] = kept[start - low : stop - low]
        return active

    def _along(self, axis: int) -> Float:
        with self._rows() as sums:
            return np.asarray(sums[: self._size, axis] / sums[: self._size, WEIGHT])

    @contextmanager
    def _rows(self) -> Iterator[NDArray[np.float64]]:
        """The file as a memory map (capacity, 5), extended with zeros as needed."""
        try:
            if self._size > self._capacity:
                self._capacity = -(-self._size // BLOCK) * BLOCK
                with self._path.open("r+b") as file:
                    file.truncate(self._capacity * 5 * 8)
            if not self._capacity:
                yield np.empty((0, 5))
                return
            sums = np.memmap(self._path, np.float64, "r+", shape=(self._capacity, 5))
        except OSError as error:
            raise MappingError(
                f"{self._path}: cannot be written ({error.strerror}); check the disk"
            ) from None
        yield sums


def suppress(p_w: Float, n: Int, radius: float) -> NDArray[np.bool_]:
    """Mask (A,) of active anchors: no neighbour within `radius` has more observations (VI-C.2).

    p_w: (A, 3), radius: world units, inclusive. n: (A,) observation counts. For each distinct
    count, one KD-tree of the anchors with more; only the nearest is queried, so memory is O(A)
    at any density.
    """
    from scipy.spatial import cKDTree

    active = np.ones(len(n), bool)
    # distance_upper_bound of the KD-tree is exclusive: query slightly further, then compare
    bound = radius * (1 + 1e-9) + 1e-12
    for count in np.unique(n)[:-1]:
        tree = cKDTree(p_w[n > count])
        here = np.flatnonzero(n == count)
        distance, _ = tree.query(p_w[here], distance_upper_bound=bound)
        active[here] = distance > radius
    return active
