"""Read and write point clouds with colours as binary PLY, written tile by tile."""

from __future__ import annotations

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
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise CloudError(f"{path}: cannot be read ({error.strerror})") from None
    head, end, body = raw.partition(b"end_header\n")
    lines = head.decode("ascii", "replace").splitlines()
    counts = [line.split()[2] for line in lines if line.startswith("element vertex ")]
    ours = [line for line in lines if line.startswith("property")] == PROPERTIES
    if not (end and ours and len(counts) == 1 and counts[0].isdigit()):
        raise CloudError(f"{path}: not a cloud of calm-edge map; give its map.ply")
    count = int(counts[0])
    if len(body) != count * VERTEX.itemsize:
        raise CloudError(
            f"{path}: holds {len(body) // VERTEX.itemsize} of {count} points; "
            "run calm-edge map again"
        )
    vertices = np.frombuffer(body, VERTEX)
    return vertices["p"].copy(), vertices["color"].copy()
