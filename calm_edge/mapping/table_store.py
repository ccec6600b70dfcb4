"""Anchor tables of all sub-maps: a cache in memory, the rest in scratch files."""

from __future__ import annotations

import dataclasses
from collections import OrderedDict
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from calm_edge.mapping.views import MappingError
from calm_edge.types import AnchorTable

# number of tables in memory: of the new sub-map and those its anchors are propagated back to
CACHED = 8


class TableStore(Mapping[int, AnchorTable]):
    """Mapping from sub-map id to AnchorTable, in order of insertion, with write-back caching.

    A changed table is written when it is evicted from memory. The caller removes the folder.
    Access raises MappingError if a file cannot be read or written.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._ids: dict[int, None] = {}
        self._cache: OrderedDict[int, AnchorTable] = OrderedDict()
        self._unwritten: set[int] = set()

    def __setitem__(self, submap_id: int, table: AnchorTable) -> None:
        self._ids[submap_id] = None
        self._unwritten.add(submap_id)
        self._keep(submap_id, table)

    def __getitem__(self, submap_id: int) -> AnchorTable:
        if submap_id not in self._ids:
            raise KeyError(submap_id)
        table = self._cache.get(submap_id)
        self._keep(submap_id, self._read(submap_id) if table is None else table)
        return self._cache[submap_id]

    def __iter__(self) -> Iterator[int]:
        return iter(self._ids)

    def __len__(self) -> int:
        return len(self._ids)

    def _keep(self, submap_id: int, table: AnchorTable) -> None:
        self._cache[submap_id] = table
        self._cache.move_to_end(submap_id)
        while len(self._cache) > CACHED:
            old, gone = self._cache.popitem(last=False)
            if old in self._unwritten:
                self._write(old, gone)
                self._unwritten.remove(old)

    def _path(self, submap_id: int) -> Path:
        return self._folder / f"anchors{submap_id:06d}.npz"

    def _write(self, submap_id: int, table: AnchorTable) -> None:
        arrays = {f.name: getattr(table, f.name) for f in dataclasses.fields(table)}
        try:
            np.savez(self._path(submap_id), **arrays)
        except OSError as error:
            raise MappingError(
                f"{self._folder}: cannot write anchors ({error.strerror}); check the disk"
            ) from None

    def _read(self, submap_id: int) -> AnchorTable:
        path = self._path(submap_id)
        try:
            with np.load(path, allow_pickle=False) as arrays:
                return AnchorTable(**arrays)
        except OSError as error:
            raise MappingError(
                f"{path}: scratch file cannot be read ({error}); run calm-edge map again"
            ) from None
