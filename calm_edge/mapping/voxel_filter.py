"""Which voxels of the map are filled: those around in memory, all others on disk."""

from __future__ import annotations

from collections import OrderedDict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calm_edge.mapping.cloud import HALF, first_of_each, voxel_keys
from calm_edge.mapping.views import MappingError
from calm_edge.types import Int

# a block is 256 voxels wide: about what one camera sees at the default range
BLOCK_BITS = 8
# voxels kept in memory, 8 bytes each; one sub-map's blocks hold far fewer
CACHED = 1 << 22


class VoxelFilter:
    """Gives every voxel of the map out once, however long the map is.

    Blocks of 256^3 voxels live in files once the map has moved on, so memory holds at most
    `CACHED` voxels beside the blocks of one call. The caller removes the folder.
    """

    def __init__(self, voxel: float, folder: Path) -> None:
        """voxel: edge, in the points' unit."""
        self._voxel = voxel
        self._folder = folder
        self._blocks: OrderedDict[int, Int] = OrderedDict()
        self._written: set[int] = set()
        self._held = 0

    @property
    def held(self) -> int:
        """Voxels in memory."""
        return self._held

    def admit(self, points: NDArray[np.floating]) -> Int:
        """Ascending indices of points (M, 3) that are the first in their voxel; fills those.

        Raises MappingError where the disk refuses.
        """
        keys = block_major(voxel_keys(points, self._voxel))
        first = first_of_each(keys)
        first = first[np.argsort(keys[first])]
        block = keys[first] >> (3 * BLOCK_BITS)
        cuts = np.flatnonzero(np.diff(block)) + 1
        starts = np.concatenate([[0], cuts])[: len(first)]
        admitted = [np.empty(0, np.int64)]
        for start, members in zip(starts, np.split(first, cuts), strict=False):
            admitted.append(members[self._fill(int(block[start]), keys[members])])
        self._shrink()
        return np.sort(np.concatenate(admitted))

    def _fill(self, block: int, keys: Int) -> NDArray[np.bool_]:
        """(M,) those of ascending distinct keys (M,) of one block that were empty till now."""
        filled = self._blocks.get(block)
        if filled is None:
            filled = self._read(block) if block in self._written else np.empty(0, np.int64)
            self._held += len(filled)
        at = np.searchsorted(filled, keys)
        fresh = np.ones(len(keys), bool)
        inside = at < len(filled)
        fresh[inside] = filled[at[inside]] != keys[inside]
        self._blocks[block] = np.insert(filled, at[fresh], keys[fresh])
        self._blocks.move_to_end(block)
        self._held += int(fresh.sum())
        return fresh

    def _shrink(self) -> None:
        while self._held > CACHED:
            block, filled = self._blocks.popitem(last=False)
            self._held -= len(filled)
            try:
                np.save(self._path(block), filled)
            except OSError as error:
                raise MappingError(
                    f"{self._folder}: cannot spool voxels ({error.strerror})"
                ) from None
            self._written.add(block)

    def _read(self, block: int) -> Int:
        try:
            return np.asarray(np.load(self._path(block), allow_pickle=False))
        except OSError as error:
            raise MappingError(
                f"{self._path(block)}: spooled voxels cannot be read ({error})"
            ) from None

    def _path(self, block: int) -> Path:
        return self._folder / f"voxels{block:x}.npy"


def block_major(keys: Int) -> Int:
    """(M,) voxel keys (M,) with their bits regrouped: the block's number, then the place in it."""
    cells = [(keys >> shift) & (2 * HALF - 1) for shift in (42, 21, 0)]
    blocks, places = np.zeros_like(keys), np.zeros_like(keys)
    for cell in cells:
        blocks = blocks << (21 - BLOCK_BITS) | cell >> BLOCK_BITS
        places = places << BLOCK_BITS | cell & ((1 << BLOCK_BITS) - 1)
    return blocks << (3 * BLOCK_BITS) | places
