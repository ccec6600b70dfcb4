"""Files of a sparse model of COLMAP: cameras, rigs, frames, images and points3D; .txt or .bin."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

Pose = tuple[float, ...]
RIG = 1


@dataclass(frozen=True, slots=True)
class CameraRow:
    """A camera with the name and the number of its model."""

    id: int
    model: str
    number: int
    params: list[float]
    width: int
    height: int


@dataclass(frozen=True, slots=True)
class FrameRow:
    """A frame of the rig. pose: rig_from_world. pictures: (camera id, image id) of each."""

    id: int
    pose: Pose
    pictures: tuple[tuple[int, int], ...]


@dataclass(frozen=True, slots=True)
class ImageRow:
    """An image. pose: cam_from_world. points: x, y [px] and point id of each observation."""

    id: int
    pose: Pose
    camera_id: int
    name: str
    points: tuple[tuple[float, float, int], ...]


@dataclass(frozen=True, slots=True)
class PointRow:
    """A point. track: image id and place among the image's points, of each observation."""

    id: int
    xyz: list[float]
    rgb: list[int]
    error: float
    track: tuple[tuple[int, int], ...]


@dataclass(frozen=True, slots=True)
class Model:
    """A sparse model with one rig. rig: sensor_from_rig of the second camera, if there are two.

    Poses are quaternion w, x, y, z and translation.
    """

    cameras: tuple[CameraRow, ...]
    rig: Pose | None
    frames: tuple[FrameRow, ...]
    images: tuple[ImageRow, ...]
    points: tuple[PointRow, ...]


def write_text(folder: Path, model: Model) -> None:
    """Write the .txt files."""
    cameras = (_line(c.id, c.model, c.width, c.height, *c.params) for c in model.cameras)
    _save(folder / "cameras.txt", "CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]", cameras)
    first = model.cameras[0].id
    second: list[float | str] = []
    if model.rig is not None:
        second = ["CAMERA", model.cameras[1].id, 1, *model.rig]
    head = (
        "RIG_ID, NUM_SENSORS, REF_SENSOR_TYPE, REF_SENSOR_ID, "
        "SENSORS[] as (SENSOR_TYPE, SENSOR_ID, HAS_POSE, [QW, QX, QY, QZ, TX, TY, TZ])"
    )
    _save(folder / "rigs.txt", head, [_line(RIG, len(model.cameras), "CAMERA", first, *second)])
    head = (
        "FRAME_ID, RIG_ID, RIG_FROM_WORLD[QW, QX, QY, QZ, TX, TY, TZ], NUM_DATA_IDS, "
        "DATA_IDS[] as (SENSOR_TYPE, SENSOR_ID, DATA_ID)"
    )
    frames = (
        _line(f.id, RIG, *f.pose, len(f.pictures), *(v for p in f.pictures for v in ("CAMERA", *p)))
        for f in model.frames
    )
    _save(folder / "frames.txt", head, frames)
    head = "IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME; POINTS2D[] as (X, Y, POINT3D_ID)"
    images = (
        line
        for i in model.images
        for line in (
            _line(i.id, *i.pose, i.camera_id, i.name),
            _line(*(value for point in i.points for value in point)),
        )
    )
    _save(folder / "images.txt", head, images)
    head = "POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)"
    points = (
        _line(p.id, *p.xyz, *p.rgb, p.error, *(v for seen in p.track for v in seen))
        for p in model.points
    )
    _save(folder / "points3D.txt", head, points)


def write_binary(folder: Path, model: Model) -> None:
    """Write the .bin files, little endian. A sensor of type 0 is a camera."""
    cameras = (
        struct.pack(f"<IiQQ{len(c.params)}d", c.id, c.number, c.width, c.height, *c.params)
        for c in model.cameras
    )
    _pack(folder / "cameras.bin", len(model.cameras), cameras)
    rig = struct.pack("<IIiI", RIG, len(model.cameras), 0, model.cameras[0].id)
    if model.rig is not None:
        rig += struct.pack("<iIB7d", 0, model.cameras[1].id, 1, *model.rig)
    _pack(folder / "rigs.bin", 1, [rig])
    frames = (
        struct.pack("<II7dI", f.id, RIG, *f.pose, len(f.pictures))
        + b"".join(struct.pack("<iIQ", 0, *picture) for picture in f.pictures)
        for f in model.frames
    )
    _pack(folder / "frames.bin", len(model.frames), frames)
    images = (
        struct.pack("<I7dI", i.id, *i.pose, i.camera_id)
        + i.name.encode()
        + struct.pack("<BQ", 0, len(i.points))
        + b"".join(struct.pack("<ddQ", *point) for point in i.points)
        for i in model.images
    )
    _pack(folder / "images.bin", len(model.images), images)
    points = (
        struct.pack("<Q3d3BdQ", p.id, *p.xyz, *p.rgb, p.error, len(p.track))
        + b"".join(struct.pack("<II", *seen) for seen in p.track)
        for p in model.points
    )
    _pack(folder / "points3D.bin", len(model.points), points)


def _line(*values: float | str) -> str:
    return " ".join(repr(v) if isinstance(v, float) else str(v) for v in values) + "\n"


def _save(path: Path, head: str, lines: Iterable[str]) -> None:
    with path.open("w") as file:
        file.write(f"# {head}\n")
        file.writelines(lines)


def _pack(path: Path, count: int, rows: Iterable[bytes]) -> None:
    with path.open("wb") as file:
        file.write(struct.pack("<Q", count))
        file.writelines(rows)
