"""Read and write point clouds with colours as binary PLY, written tile by tile."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import BinaryIO

import numpy as np

from calm_edge.types import Bytes, CalmEdgeError, Float32, MapTile

VERTEX = np.dtype([("p", "<f4", 3), ("color", "u1", 3)])
PROPERTIES = [f"property float {a}" for a in "xyz"] + [
    f"property uchar {c}" for c in ("red", "green", "blue")
]


class CloudError(CalmEdgeError):
    """A point cloud file cannot be written or read."""


def _header(count: int) -> bytes:
    # a comment pads the header to a fixed length, so that the count can be rewritten at the end
    pad = "." * (20 - len(str(count)))
    lines = ["ply", "format binary_little_endian 1.0", f"comment calm-edge {pad}"]
    lines += [f"element vertex {count}", *PROPERTIES, "end_header", ""]
    return "\n".join(lines).encode("ascii")


class CloudWriter:
    """Context manager that writes tiles to `path`.part and renames it to `path` on success.

    After an exception the .part is removed, and an existing file is unchanged. replace: overwrite
    an existing file. count: points written so far. Raises CloudError if the file exists or cannot
    be written.
    """

    def __init__(self, path: Path, *, replace: bool = False) -> None:
        self._path = path
        self._part = path.with_name(path.name + ".part")
        self.count = 0
        if path.exists() and not replace:
            raise CloudError(f"{path}: exists already; choose another output folder")
        try:
            self._file: BinaryIO = self._part.open("wb")
            self._file.write(_header(0))
        except OSError as error:
            raise CloudError(f"{path}: cannot be written ({error.strerror})") from None

    def write(self, tile: MapTile) -> None:
        """Append the points of a tile."""
        vertices = np.empty(len(tile.points_w), VERTEX)
        vertices["p"], vertices["color"] = tile.points_w, tile.color
        try:
            self._file.write(vertices.tobytes())
        except OSError as error:
            raise CloudError(f"{self._path}: cannot be written ({error.strerror})") from None
        self.count += len(vertices)

    def __enter__(self) -> CloudWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if kind is not None:
            self._file.close()
            self._part.unlink(missing_ok=True)
            return
        try:
            self._file.seek(0)
            self._file.write(_header(self.count))
            self._file.close()
            self._part.rename(self._path)
        except OSError as failure:
            raise CloudError(f"{self._path}: cannot be written ({failure.strerror})") from None


def read_cloud(path: Path) -> tuple[Float32, Bytes]:
    """Read points (P, 3) and colours (P, 3) RGB from a PLY written by CloudWriter.

    Raises CloudError.
    """
    tiles = list(read_tiles(path, max(count_points(path), 1)))
    if not tiles:
        return np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8)
    return tiles[0].points_w, tiles[0].color


def count_points(path: Path) -> int:
    """Number of points of a PLY written by CloudWriter; raises CloudError."""
    return _layout(path)[1]


def read_tiles(path: Path, size: int) -> Iterator[MapTile]:
    """Read a PLY written by CloudWriter, at most `size` points at a time; raises CloudError."""
    start, count = _layout(path)
    try:
        with path.open("rb") as file:
            file.seek(start)
            for done in range(0, count, size):
                vertices = np.frombuffer(
                    file.read(min(size, count - done) * VERTEX.itemsize), VERTEX
                )
                yield MapTile(vertices["p"].copy(), vertices["color"].copy())
    except OSError as error:
        raise CloudError(f"{path}: cannot be read ({error.strerror})") from None


def _layout(path: Path) -> tuple[int, int]:
    """Offset of the first point, and number of points; raises CloudError."""
    try:
        with path.open("rb") as file:
            head, end, _ = file.read(4096).partition(b"end_header\n")
        size = path.stat().st_size
    except OSError as error:
        raise CloudError(f"{path}: cannot be read ({error.strerror})") from None
    lines = head.decode("ascii", "replace").splitlines()
    counts = [line.split()[2] for line in lines if line.startswith("element vertex ")]
    ours = [line for line in lines if line.startswith("property")] == PROPERTIES
    if not (end and ours and len(counts) == 1 and counts[0].isdigit()):
        raise CloudError(f"{path}: not a cloud of calm-edge map; give its map.ply")
    start, count = len(head) + len(end), int(counts[0])
    if size - start != count * VERTEX.itemsize:
        raise CloudError(
            f"{path}: holds {(size - start) // VERTEX.itemsize} of {count} points; "
            "run calm-edge map again"
        )
    return start, count
