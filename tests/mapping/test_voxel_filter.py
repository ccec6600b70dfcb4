import numpy as np
import pytest

from calm_edge.mapping import voxel_filter
from calm_edge.mapping.cloud import HALF, voxel_keys
from calm_edge.mapping.views import MappingError
from calm_edge.mapping.voxel_filter import VoxelFilter, block_major


def expected_of(points, voxel, seen):
    expected = []
    for i, cell in enumerate(map(tuple, np.floor(points / voxel).astype(int))):
        if cell not in seen:
            seen.add(cell)
            expected.append(i)
    return expected


def test_a_voxel_admits_one_point_across_tiles(tmp_path):
    rng = np.random.default_rng(0)
    thin = VoxelFilter(0.5, tmp_path)
    seen: set[tuple[int, ...]] = set()
    for _ in range(6):
        points = rng.uniform(-3, 3, (400, 3))
        assert thin.admit(points).tolist() == expected_of(points, 0.5, seen)
    assert len(thin.admit(np.empty((0, 3)))) == 0


def test_voxels_on_disk_stay_occupied_and_memory_is_bounded(tmp_path, monkeypatch):
    monkeypatch.setattr(voxel_filter, "CACHED", 3000)
    rng = np.random.default_rng(1)
    thin = VoxelFilter(0.1, tmp_path)
    seen: set[tuple[int, ...]] = set()
    # along the path and back, past blocks that are on disk
    for k in [*range(8), *range(8)]:
        low = np.array([30.0 * k, 0, -200])
        points = rng.uniform(low, low + 10, (1000, 3))
        assert thin.admit(points).tolist() == expected_of(points, 0.1, seen)
        assert thin._held <= 3000
    assert len(list(tmp_path.iterdir())) >= 5


def test_a_block_is_256_voxels_wide_and_its_keys_stay_distinct():
    cells = np.array([[0, 0, 0], [255, 0, 0], [256, 0, 0], [0, 255, 255], [0, 256, 0], [-1, 0, 0]])
    keys = block_major(voxel_keys(cells + 0.5, 1.0))
    assert len(np.unique(keys)) == len(keys)
    blocks = keys >> 24
    assert blocks[0] == blocks[1] == blocks[3]
    assert len(np.unique(blocks)) == 4
    corners = block_major(voxel_keys(np.array([[-HALF, -HALF, -HALF], [HALF, HALF, HALF]]), 1.0))
    assert corners[0] == 0 and corners[1] == (1 << 63) - 1


def test_a_lost_block_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(voxel_filter, "CACHED", 0)
    thin = VoxelFilter(1.0, tmp_path)
    thin.admit(np.zeros((1, 3)))
    for file in tmp_path.iterdir():
        file.unlink()
    with pytest.raises(MappingError, match="scratch file cannot be read"):
        thin.admit(np.zeros((1, 3)))
