"""Voxel filter over the whole map, with distant voxels in scratch files."""

from __future__ import annotations

from collections import OrderedDict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calm_edge.mapping.cloud import HALF, first_of_each, voxel_keys
from calm_edge.mapping.views import MappingError
from calm_edge.types import Int

# block of 2^8 voxels per axis, about the range of a camera with the default configuration
BLOCK_BITS = 8
# voxels kept in memory, 8 bytes each, many times those of one sub-map
CACHED = 1 << 22


class VoxelFilter:
    """Filter that admits one point per voxel of a map of any size.

    Occupied voxels are grouped in blocks of 256^3; blocks not used recently are moved to files,
    so that memory holds `CACHED` voxels plus the blocks of one call. The caller removes the folder.
    """

    def __init__(self, voxel: float, folder: Path) -> None:
        """voxel: edge length, in the unit of the points."""
        self._voxel = voxel
        self._folder = folder
        self._blocks: OrderedDict[int, Int] = OrderedDict()
        self._written: set[int] = set()
        self._held = 0

    def admit(self, points: NDArray[np.floating]) -> Int:
        """Ascending indices of points (M, 3) that are the first in their voxel; marks it occupied.

        Raises MappingError if a scratch file cannot be read or written.
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
        """Mark voxels of one block occupied; returns the mask (M,) of those that were free.

        keys: (M,) ascending, distinct.
        """
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
                    f"{self._folder}: cannot write voxels ({error.strerror}); check the disk"
                ) from None
            self._written.add(block)

    def _read(self, block: int) -> Int:
        try:
            return np.asarray(np.load(self._path(block), allow_pickle=False))
        except OSError as error:
            raise MappingError(
                f"{self._path(block)}: scratch file cannot be read ({error}); "
                "run calm-edge map again"
            ) from None

    def _path(self, block: int) -> Path:
        return self._folder / f"voxels{block:x}.npy"


def block_major(keys: Int) -> Int:
    """Regroup the bits of voxel keys (M,): high bits the block index, low bits the voxel in it."""
    cells = [(keys >> shift) & (2 * HALF - 1) for shift in (42, 21, 0)]
    blocks, places = np.zeros_like(keys), np.zeros_like(keys)
    for cell in cells:
        blocks = blocks << (21 - BLOCK_BITS) | cell >> BLOCK_BITS
        places = places << BLOCK_BITS | cell & ((1 << BLOCK_BITS) - 1)
    return blocks << (3 * BLOCK_BITS) | places
