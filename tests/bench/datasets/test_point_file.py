from pathlib import Path

import numpy as np
import pytest

from bench.datasets.point_file import read_points
from calm_edge.interchange.published import DatasetError

POINTS = np.array([[1.0, 2.0, 3.0], [-4.5, 5.25, 6.0]])


def header(form: str, properties: list[str], count: int = 2) -> bytes:
    lines = ["ply", f"format {form} 1.0", "comment made here", f"element vertex {count}"]
    lines += [f"property {p}" for p in properties] + ["end_header", ""]
    return "\n".join(lines).encode()


@pytest.mark.parametrize("order", ["little", "big"])
def test_binary_vertices_with_more_than_a_position(tmp_path: Path, order: str) -> None:
    sign = "<" if order == "little" else ">"
    kind = np.dtype([("i", sign + "u2"), ("p", sign + "f4", 3), ("t", sign + "f8")])
    rows = np.zeros(2, kind)
    rows["p"] = POINTS
    properties = ["ushort i", "float x", "float y", "float z", "double t"]
    path = tmp_path / "p.ply"
    path.write_bytes(header(f"binary_{order}_endian", properties) + rows.tobytes())
    np.testing.assert_array_equal(read_points(path), POINTS)


def test_ascii_in_any_order_of_columns(tmp_path: Path) -> None:
    body = "".join(f"7 {z} {y} {x}\n" for x, y, z in POINTS)
    properties = ["int ring", "float z", "float y", "float x"]
    (tmp_path / "p.ply").write_bytes(header("ascii", properties) + body.encode())
    np.testing.assert_array_equal(read_points(tmp_path / "p.ply"), POINTS)


def test_no_points_are_none(tmp_path: Path) -> None:
    for form in ("ascii", "binary_little_endian"):
        path = tmp_path / f"{form}.ply"
        path.write_bytes(header(form, ["float x", "float y", "float z"], 0))
        assert read_points(path).shape == (0, 3)


@pytest.mark.parametrize(
    ("raw", "names"),
    [
        (b"solid", "not a PLY"),
        (header("binary_little_endian", ["float x", "float y"]), "not a PLY"),
        (header("strange", ["float x", "float y", "float z"]), "not a PLY"),
        (header("binary_little_endian", ["float x", "float y", "float z"]) + b"12", "truncated"),
        (header("ascii", ["float x", "float y", "float z"]) + b"1 2 3\n", "truncated"),
        (header("ascii", ["float x", "float y", "float z"]) + b"1 2\n3 4\n", "truncated"),
    ],
)
def test_what_is_no_point_file_is_named(tmp_path: Path, raw: bytes, names: str) -> None:
    (tmp_path / "p.ply").write_bytes(raw)
    with pytest.raises(DatasetError, match=rf"p\.ply: {names}"):
        read_points(tmp_path / "p.ply")


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"gone\.ply: cannot be read"):
        read_points(tmp_path / "gone.ply")
