"""Kalibr's camchain YAML: cam0, cam1, with `T_cn_cnm1` from each camera to the next [m]."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from calm_edge.geometry import se3
from calm_edge.geometry.fisheye import Fisheye
from calm_edge.interchange.calibration.calibration import (
    CalibratedCamera,
    Calibration,
    CalibrationError,
    checked,
)
from calm_edge.interchange.calibration.fields import is_yaml_with, numbers, parsed_yaml, transform
from calm_edge.interchange.calibration.fit import fitted
from calm_edge.interchange.calibration.lens import (
    Lens,
    Plane,
    double_sphere,
    extended_unified,
    field_of_view,
    unified,
)
from calm_edge.interchange.calibration.opencv import coefficients, distorted_camera

FILE = "camchain.yaml"
# number of intrinsics before fu, fv, pu, pv, by camera model; of coefficients, by distortion model
_OWN = {"pinhole": 0, "omni": 1, "ds": 2, "eucm": 2}
_COEFFICIENTS = {"none": 0, "radtan": 4, "equidistant": 4, "fov": 1}


def recognises(path: Path, data: bytes) -> bool:
    """Whether the file has a cam0."""
    return is_yaml_with(data, "cam0")


def read(path: Path, data: bytes) -> Calibration:
    """Read all cameras, and the rig of the first two."""
    content = parsed_yaml(path, data)
    names = sorted(name for name in content if str(name).startswith("cam"))
    for name in names:
        if not isinstance(content[name], dict):
            raise CalibrationError(f"{path}: {name} holds no camera")
    cameras = tuple(_camera(f"{path}: {name}", content[name]) for name in names)
    T_a_p = content[names[1]].get("T_cn_cnm1") if len(names) > 1 else None
    if T_a_p is None:
        return Calibration(cameras)
    rig = transform(f"{path}: {names[1]}", "T_cn_cnm1", T_a_p)
    return Calibration(cameras, se3.inverse(rig), metric=True)


def write(folder: Path, calibration: Calibration, notes: tuple[str, ...]) -> list[Path]:
    """Write a camchain; pinhole cameras with radtan or equidistant distortion."""
    content: dict[str, Any] = {}
    for number, each in enumerate(calibration.cameras):
        lens, k = each.camera, coefficients(each.camera)
        if len(k) > 4 and any(k[4:]):
            raise CalibrationError(
                "kalibr: radtan holds no more than k1, k2, p1 and p2; use --format opencv or ros"
            )
        content[f"cam{number}"] = {
            "camera_model": "pinhole",
            "intrinsics": [float(value) for value in (lens.fx, lens.fy, lens.cx, lens.cy)],
            "distortion_model": "equidistant" if isinstance(lens, Fisheye) else "radtan",
            "distortion_coeffs": k[:4],
            "resolution": [lens.width, lens.height],
            "rostopic": f"/{('primary', 'assistant')[number]}/image",
        }
    if calibration.T_p_a is not None and len(calibration.cameras) == 2:
        content["cam1"]["T_cn_cnm1"] = se3.inverse(calibration.T_p_a).tolist()
    comment = "".join(f"# {note}\n" for note in notes)
    path = folder / FILE
    path.write_text(comment + yaml.safe_dump(content, sort_keys=False, default_flow_style=None))
    return [path]


def _camera(where: str, entry: dict[str, Any]) -> CalibratedCamera:
    model, distortion = entry.get("camera_model"), entry.get("distortion_model") or "none"
    if model not in _OWN:
        raise CalibrationError(
            f"{where}: camera_model {model!r} is not supported ({', '.join(_OWN)} are)"
        )
    if distortion not in _COEFFICIENTS:
        raise CalibrationError(
            f"{where}: distortion_model {distortion!r} is not supported "
            f"({', '.join(_COEFFICIENTS)} are)"
        )
    own = _OWN[model]
    values = numbers(where, "intrinsics", entry.get("intrinsics"), (own + 4,))
    k = numbers(where, "distortion_coeffs", entry.get("distortion_coeffs") or [])
    k = k[: _COEFFICIENTS[distortion]]
    if len(k) < _COEFFICIENTS[distortion]:
        raise CalibrationError(f"{where}: distortion_coeffs has too few numbers for {distortion}")
    width, height = numbers(where, "resolution", entry.get("resolution"), (2,))
    fu, fv, pu, pv = values[own:]
    size, matrix = (int(width), int(height)), (fu, fv, pu, pv)
    if model == "pinhole" and distortion != "fov":
        fisheye = distortion == "equidistant"
        return distorted_camera(where, matrix, k, size, fisheye=fisheye)
    camera, off_px = fitted(
        where, Lens(_plane(where, model, values, distortion, k), *matrix, *size)
    )
    return checked(where, CalibratedCamera(camera, f"{model}-{distortion}", off_px))


def _plane(where: str, model: str, values: list[float], distortion: str, k: list[float]) -> Plane:
    if model == "pinhole":
        return field_of_view(k[0])
    if model == "omni" and distortion in ("none", "radtan"):
        return unified(values[0], k)
    if distortion != "none":
        raise CalibrationError(f"{where}: {model} with {distortion} distortion is not supported")
    if model == "ds":
        return double_sphere(*values[:2])
    return extended_unified(*values[:2])
