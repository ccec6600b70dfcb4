import dataclasses

import numpy as np
import pytest

from calm_edge.mapping import table_store
from calm_edge.mapping.table_store import TableStore
from calm_edge.mapping.views import MappingError
from calm_edge.types import AnchorTable


def table(k: int, size: int = 5) -> AnchorTable:
    rng = np.random.default_rng(k)
    return AnchorTable(
        rng.integers(0, 99, size),
        rng.normal(size=(size, 3)),
        rng.integers(0, 99, size).astype(np.int32),
        rng.integers(0, 30, size).astype(np.int32),
        rng.uniform(0, 600, (size, 2)).astype(np.float32),
    )


def assert_same(a: AnchorTable, b: AnchorTable) -> None:
    for field in dataclasses.fields(AnchorTable):
        x, y = getattr(a, field.name), getattr(b, field.name)
        np.testing.assert_array_equal(x, y)
        assert x.dtype == y.dtype


def test_tables_are_read_back_as_last_set(tmp_path, monkeypatch):
    monkeypatch.setattr(table_store, "CACHED", 2)
    store = TableStore(tmp_path)
    for k in range(6):
        store[k] = table(k)
    # sub-map 1 gets more rows after it was written to disk
    store[1] = AnchorTable.joined([store[1], table(70)])
    for k in (0, 2, 3, 4, 5):
        assert_same(store[k], table(k))
    assert_same(store[1], AnchorTable.joined([table(1), table(70)]))
    assert list(store) == [0, 1, 2, 3, 4, 5] and len(store) == 6
    assert 3 in store and 6 not in store


def test_a_table_in_memory_is_not_read_again(tmp_path, monkeypatch):
    monkeypatch.setattr(table_store, "CACHED", 2)
    store = TableStore(tmp_path)
    store[0] = table(0)
    assert store[0] is store[0]
    assert not list(tmp_path.iterdir())


def test_a_missing_file_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(table_store, "CACHED", 1)
    store = TableStore(tmp_path)
    store[0], store[1] = table(0), table(1)
    for file in tmp_path.iterdir():
        file.unlink()
    with pytest.raises(MappingError, match="anchors000000"):
        store[0]
    with pytest.raises(KeyError):
        store[2]
