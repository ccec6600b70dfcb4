"""COLMAP's cameras.txt or cameras.bin, and its rigs.txt or rigs.bin if they are beside it.

COLMAP's pixel centres are at half pixels: its principal point is 0.5 larger than ours.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera
from calm_edge.geometry.fisheye import Fisheye
from calm_edge.interchange.calibration.calibration import (
    CalibratedCamera,
    Calibration,
    CalibrationError,
    checked,
)
from calm_edge.interchange.calibration.fields import numbers
from calm_edge.interchange.calibration.fit import fitted
from calm_edge.interchange.calibration.lens import (
    Lens,
    Plane,
    division,
    extended_unified,
    field_of_view,
    rad_tan_thin_prism_fisheye,
    thin_prism_fisheye,
)
from calm_edge.interchange.calibration.opencv import coefficients, distorted_camera
from calm_edge.types import Float

FILE, RIGS = "cameras.txt", "rigs.txt"
# added to principal points and pixels
CENTRE = 0.5


@dataclass(frozen=True, slots=True)
class _Model:
    """A model of COLMAP. number: in binary files. focals: 1 or 2. terms: of the distortion.

    Without `plane` it is OpenCV's model, with the first of its terms. plane: projection of another
    model with given terms.
    """

    name: str
    number: int
    focals: int
    terms: int
    fisheye: bool = False
    plane: Callable[[list[float]], Plane] | None = None

    @property
    def size(self) -> int:
        return self.focals + 2 + self.terms


_MODELS = (
    _Model("SIMPLE_PINHOLE", 0, 1, 0),
    _Model("PINHOLE", 1, 2, 0),
    _Model("SIMPLE_RADIAL", 2, 1, 1),
    _Model("RADIAL", 3, 1, 2),
    _Model("OPENCV", 4, 2, 4),
    _Model("OPENCV_FISHEYE", 5, 2, 4, fisheye=True),
    _Model("FULL_OPENCV", 6, 2, 8),
    _Model("FOV", 7, 2, 1, plane=lambda k: field_of_view(k[0])),
    _Model("SIMPLE_RADIAL_FISHEYE", 8, 1, 1, fisheye=True),
    _Model("RADIAL_FISHEYE", 9, 1, 2, fisheye=True),
    _Model("THIN_PRISM_FISHEYE", 10, 2, 8, plane=thin_prism_fisheye),
    _Model("RAD_TAN_THIN_PRISM_FISHEYE", 11, 2, 12, plane=rad_tan_thin_prism_fisheye),
    _Model("SIMPLE_DIVISION", 12, 1, 1, plane=lambda k: division(k[0])),
    _Model("DIVISION", 13, 2, 1, plane=lambda k: division(k[0])),
    _Model("SIMPLE_FISHEYE", 14, 1, 0, fisheye=True),
    _Model("FISHEYE", 15, 2, 0, fisheye=True),
    _Model("EUCM", 16, 2, 2, plane=lambda k: extended_unified(*k)),
)
_BY_NAME = {model.name: model for model in _MODELS}
_BY_NUMBER = {model.number: model for model in _MODELS}


def recognises(path: Path, data: bytes) -> bool:
    """Whether the name is COLMAP's, or a line of text names one of its models."""
    if path.name in ("cameras.txt", "cameras.bin"):
        return True
    lines = data.decode(errors="replace").splitlines()
    return any(line.split()[1:2] and line.split()[1] in _BY_NAME for line in lines)


def read(path: Path, data: bytes) -> Calibration:
    """Read all cameras by ascending id, and the rig of the first two."""
    read_cameras = _binary_cameras if path.suffix == ".bin" else _text_cameras
    try:
        rows = sorted(read_cameras(path, data))
    except (struct.error, ValueError):
        raise CalibrationError(f"{path}: damaged, or not a list of COLMAP cameras") from None
    if not rows:
        raise CalibrationError(f"{path}: holds no camera")
    cameras = tuple(
        _camera(f"{path}: camera {number}", model, width, height, params)
        for number, model, width, height, params in rows
    )
    rig = _rig(path, rows[0][0], rows[1][0]) if len(rows) > 1 else None
    return Calibration(cameras, rig)


def write(folder: Path, calibration: Calibration, notes: tuple[str, ...]) -> list[Path]:
    """Write cameras.txt and, with a rig, rigs.txt."""
    comment = "".join(f"# {note}\n" for note in notes)
    rows = []
    for number, each in enumerate(calibration.cameras, 1):
        lens = each.camera
        name, _, params = model_of(lens)
        text = " ".join(map(repr, params))
        rows.append(f"{number} {name} {lens.width} {lens.height} {text}\n")
    path = folder / FILE
    path.write_text(
        f"# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]; pixel centres at half pixels\n{comment}"
        + "".join(rows)
    )
    if calibration.T_p_a is None:
        return [path]
    T_a_p = se3.inverse(calibration.T_p_a)
    x, y, z, w = se3.quaternions(T_a_p[None, :3, :3])[0].tolist()
    pose = " ".join(map(repr, [w, x, y, z, *T_a_p[:3, 3].tolist()]))
    rigs = folder / RIGS
    rigs.write_text(
        "# RIG_ID, NUM_SENSORS, REF_SENSOR_TYPE, REF_SENSOR_ID, SENSORS[] as "
        "(SENSOR_TYPE, SENSOR_ID, HAS_POSE, [QW, QX, QY, QZ, TX, TY, TZ])\n"
        f"1 2 CAMERA 1 CAMERA 2 1 {pose}\n"
    )
    return [path, rigs]


def model_of(camera: Camera) -> tuple[str, int, list[float]]:
    """Name, number and parameters of COLMAP's model of a camera."""
    k = [] if camera.is_pinhole else coefficients(camera)
    name = {0: "PINHOLE", 4: "OPENCV"}.get(len(k), "FULL_OPENCV")
    if isinstance(camera, Fisheye):
        name = "OPENCV_FISHEYE"
    model = _BY_NAME[name]
    k += [0.0] * (model.terms - len(k))
    params = [camera.fx, camera.fy, camera.cx + CENTRE, camera.cy + CENTRE, *k]
    return name, model.number, [float(value) for value in params]


_Row = tuple[int, str, int, int, list[float]]


def _text_cameras(path: Path, data: bytes) -> list[_Row]:
    rows = []
    for line in data.decode().splitlines():
        if line.strip() and not line.startswith("#"):
            number, name, width, height, *params = line.split()
            rows.append((int(number), name, int(width), int(height), [float(p) for p in params]))
    return rows


def _binary_cameras(path: Path, data: bytes) -> list[_Row]:
    (count,), at, rows = struct.unpack_from("<Q", data), 8, []
    for _ in range(count):
        number, kind, width, height = struct.unpack_from("<IiQQ", data, at)
        if kind not in _BY_NUMBER:
            raise CalibrationError(f"{path}: camera {number} has the unknown model {kind}")
        model = _BY_NUMBER[kind]
        params = struct.unpack_from(f"<{model.size}d", data, at + 24)
        rows.append((number, model.name, width, height, list(params)))
        at += 24 + 8 * model.size
    return rows


def _camera(
    where: str, name: str, width: int, height: int, params: list[float]
) -> CalibratedCamera:
    model = _BY_NAME.get(name)
    if model is None:
        known = ", ".join(_BY_NAME)
        raise CalibrationError(f"{where}: model {name} is not supported ({known} are)")
    values = numbers(where, f"{name} parameters", params, (model.size,))
    focals, centre, k = values[: model.focals], values[model.focals :][:2], values[-model.terms :]
    k = k if model.terms else []
    matrix = focals[0], focals[-1], centre[0] - CENTRE, centre[1] - CENTRE
    if model.plane is not None:
        camera, off_px = fitted(where, Lens(model.plane(k), *matrix, width, height))
        return checked(where, CalibratedCamera(camera, name, off_px))
    terms = 4 if model.fisheye or model.terms <= 4 else 8
    k += [0.0] * (terms - len(k))
    return distorted_camera(where, matrix, k, (width, height), fisheye=model.fisheye)


def _rig(path: Path, primary: int, assistant: int) -> Float | None:
    """T_p_a (4, 4) from the rigs file beside the cameras; None if there is none with both."""
    rigs = path.with_name(f"rigs{path.suffix}")
    if not rigs.is_file():
        return None
    read_poses = _binary_poses if path.suffix == ".bin" else _text_poses
    try:
        poses = read_poses(rigs.read_bytes())
    except (OSError, struct.error, ValueError, IndexError, CalibrationError):
        raise CalibrationError(f"{rigs}: damaged; remove it to use the cameras alone") from None
    for each in poses:
        if primary in each and assistant in each:
            T_a_p = _transform(rigs, each[assistant]) @ se3.inverse(_transform(rigs, each[primary]))
            return se3.inverse(T_a_p)
    return None


def _transform(rigs: Path, pose: list[float]) -> Float:
    """sensor_from_rig (4, 4) of a quaternion w, x, y, z and a translation."""
    q = np.array([*pose[1:4], pose[0]])
    if abs(np.linalg.norm(q) - 1) > 1e-3:
        raise CalibrationError(f"{rigs}: {pose[:4]} is not a rotation")
    return se3.compose(se3.rotations(q / np.linalg.norm(q)), np.array(pose[4:]))


_IDENTITY = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
_Poses = dict[int, list[float]]


def _text_poses(data: bytes) -> list[_Poses]:
    """Poses sensor_from_rig of each rig by camera id; a camera without a pose is left out."""
    found = []
    for line in data.decode().splitlines():
        if not line.strip() or line.startswith("#"):
            continue
        words = line.split()
        each: _Poses = {int(words[3]): _IDENTITY} if words[2] == "CAMERA" else {}
        at = 4
        while at < len(words):
            kind, number, has_pose = words[at], int(words[at + 1]), words[at + 2] == "1"
            if has_pose and kind == "CAMERA":
                each[number] = numbers("rigs", "a pose", words[at + 3 : at + 10], (7,))
            at += 10 if has_pose else 3
        found.append(each)
    return found


def _binary_poses(data: bytes) -> list[_Poses]:
    """As `_text_poses`; sensor type 0 is a camera."""
    (count,), at, found = struct.unpack_from("<Q", data), 8, []
    for _ in range(count):
        _, sensors = struct.unpack_from("<II", data, at)
        at += 8
        each: _Poses = {}
        for index in range(sensors):
            kind, number = struct.unpack_from("<iI", data, at)
            at += 8
            pose: list[float] | None = _IDENTITY
            if index:
                has_pose, at = data[at] != 0, at + 1
                pose = list(struct.unpack_from("<7d", data, at)) if has_pose else None
                at += 56 if has_pose else 0
            if kind == 0 and pose is not None:
                each[number] = pose
        found.append(each)
    return found
