"""Reader of the vertex positions of a PLY file."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from calm_edge.interchange.published import DatasetError
from calm_edge.types import Float

_KINDS = {
    "char": "i1",
    "int8": "i1",
    "uchar": "u1",
    "uint8": "u1",
    "short": "i2",
    "int16": "i2",
    "ushort": "u2",
    "uint16": "u2",
    "int": "i4",
    "int32": "i4",
    "uint": "u4",
    "uint32": "u4",
    "float": "f4",
    "float32": "f4",
    "double": "f8",
    "float64": "f8",
}
_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": "="}


def _vertex_type(lines: list[str], order: str) -> tuple[int, np.dtype[np.void]] | None:
    """Number and dtype of the vertices in a PLY header.

    None unless they are the first element and have x, y, z. order: byte order, as in NumPy.
    """
    count, fields, inside = -1, [], False
    for words in map(str.split, lines):
        if words[:1] == ["element"] and len(words) == 3:
            if count >= 0:
                break
            inside = words[1] == "vertex" and words[2].isdigit()
            if not inside:
                return None
            count = int(words[2])
        elif words[:1] == ["property"] and inside:
            if len(words) != 3 or words[1] not in _KINDS:
                return None
            fields.append((words[2], order + _KINDS[words[1]]))
    if count < 0 or not {"x", "y", "z"} <= {name for name, _ in fields}:
        return None
    return count, np.dtype(fields)


def read_points(path: Path) -> Float:
    """Read positions (M, 3) from an ASCII or binary PLY file; raises DatasetError."""
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise DatasetError(f"{path}: cannot be read ({error.strerror})") from None
    head, end, rest = raw.partition(b"end_header")
    lines = head.decode("ascii", "replace").splitlines()
    form = next((line.split()[1] for line in lines if line.startswith("format ")), "")
    found = _vertex_type(lines, _ORDERS[form]) if end and form in _ORDERS else None
    if lines[:1] != ["ply"] or found is None:
        raise DatasetError(f"{path}: not a PLY file that starts with vertices x, y, z")
    count, kind = found
    body = rest.partition(b"\n")[2]
    try:
        if form == "ascii":
            text = io.StringIO(body.decode("ascii"))
            rows = np.loadtxt(text, np.float64, max_rows=count, ndmin=2) if count else None
            names = list(kind.names or ())
            columns = [names.index(axis) for axis in "xyz"]
            points = np.zeros((0, 3)) if rows is None else rows[:, columns]
        else:
            vertices = np.frombuffer(body, kind, count)
            points = np.stack([vertices[axis].astype(np.float64) for axis in "xyz"], 1)
    except (ValueError, IndexError):
        points = np.zeros((0, 3))
    if len(points) != count:
        raise DatasetError(f"{path}: truncated; its header promises {count} points")
    return points
