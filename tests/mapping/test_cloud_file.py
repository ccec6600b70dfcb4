import numpy as np
import pytest

from calm_edge.mapping.cloud_file import CloudError, CloudWriter, read_cloud
from calm_edge.types import MapTile


def tile(seed: int, n: int) -> MapTile:
    rng = np.random.default_rng(seed)
    points = rng.normal(0, 100, (n, 3)).astype(np.float32)
    return MapTile(points, rng.integers(0, 256, (n, 3), np.uint8))


def test_tiles_come_back_in_order(tmp_path):
    tiles = [tile(0, 5), tile(1, 0), tile(2, 1234)]
    path = tmp_path / "map.ply"
    with CloudWriter(path) as writer:
        for t in tiles:
            writer.write(t)
            assert not path.exists()
        assert writer.count == 1239
    points, color = read_cloud(path)
    np.testing.assert_array_equal(points, np.concatenate([t.points_w for t in tiles]))
    np.testing.assert_array_equal(color, np.concatenate([t.color for t in tiles]))
    assert [p.name for p in tmp_path.iterdir()] == ["map.ply"]


def test_the_header_is_plain_ply_with_the_patched_count(tmp_path):
    path = tmp_path / "map.ply"
    with CloudWriter(path) as writer:
        writer.write(tile(0, 100_000))
    head, _, body = path.read_bytes().partition(b"end_header\n")
    lines = head.decode().splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    assert "element vertex 100000" in lines
    assert lines[-6:] == [
        *(f"property float {a}" for a in "xyz"),
        *(f"property uchar {c}" for c in ("red", "green", "blue")),
    ]
    assert len(body) == 15 * 100_000


def test_an_empty_map_is_a_valid_file(tmp_path):
    with CloudWriter(tmp_path / "map.ply"):
        pass
    points, color = read_cloud(tmp_path / "map.ply")
    assert points.shape == (0, 3) and color.shape == (0, 3)


def test_a_failure_leaves_nothing_behind(tmp_path):
    with pytest.raises(RuntimeError), CloudWriter(tmp_path / "map.ply") as writer:
        writer.write(tile(0, 10))
        raise RuntimeError
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_overwritten(tmp_path):
    path = tmp_path / "map.ply"
    path.write_text("mine")
    with pytest.raises(CloudError, match="exists already"):
        CloudWriter(path)
    assert path.read_text() == "mine"


def test_unwritable_and_unreadable_places_are_named(tmp_path):
    with pytest.raises(CloudError, match=r"map\.ply: cannot be written"):
        CloudWriter(tmp_path / "no" / "map.ply")
    with pytest.raises(CloudError, match=r"map\.ply: cannot be read"):
        read_cloud(tmp_path / "map.ply")


def test_the_error_of_a_truncated_file_names_the_points_left(tmp_path):
    path = tmp_path / "map.ply"
    with CloudWriter(path) as writer:
        writer.write(tile(0, 10))
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(CloudError, match="holds 7 of 10 points"):
        read_cloud(path)


@pytest.mark.parametrize("content", [b"", b"ply\nend_header\n", b"\xff\xfe\x00 nonsense"])
def test_other_files_are_refused(tmp_path, content):
    path = tmp_path / "map.ply"
    path.write_bytes(content)
    with pytest.raises(CloudError, match="not a cloud"):
        read_cloud(path)
