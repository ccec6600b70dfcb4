"""ROS camera_info: YAML of the camera_calibration package, or a message as printed by `topic echo`.

A file holds one camera. In a stereo pair (REP 104) R rotates a camera into the rectified frame of
both, and P[0, 3], P[1, 3] of the second are minus its focal lengths there times its position [m].
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera
from calm_edge.geometry.fisheye import Fisheye
from calm_edge.interchange.calibration.calibration import Calibration, CalibrationError
from calm_edge.interchange.calibration.fields import is_yaml_with, numbers, parsed_yaml
from calm_edge.interchange.calibration.opencv import coefficients, distorted_camera
from calm_edge.types import Float

NAMES = "primary", "assistant"
_FISHEYE = "equidistant", "fisheye"
_PERSPECTIVE = "plumb_bob", "rational_polynomial", "thin_prism", "none", ""


def recognises(path: Path, data: bytes) -> bool:
    """Whether the file has the keys of a camera_info."""
    return is_yaml_with(data, "distortion_model") and not is_yaml_with(data, "cam0")


def read(path: Path, data: bytes) -> Calibration:
    """Read the camera; `rig` needs the files of both."""
    content = parsed_yaml(path, data)
    size = numbers(str(path), "image_width, image_height", [
        _first(content, "image_width", "width"), _first(content, "image_height", "height"),
    ], (2,))  # fmt: skip
    K = numbers(str(path), "camera_matrix", _values(content, "camera_matrix", "K", "k"), (9,))
    D = numbers(str(path), "distortion_coefficients", _values(content, *_D) or [])
    model = str(content.get("distortion_model") or "")
    if model not in _FISHEYE + _PERSPECTIVE:
        known = ", ".join(name for name in _PERSPECTIVE[:2] + _FISHEYE[:1])
        raise CalibrationError(f"{path}: distortion_model {model!r} is not supported ({known} are)")
    _refuse_part(path, content)
    fisheye = model in _FISHEYE
    matrix = K[0], K[4], K[2], K[5]
    camera = distorted_camera(str(path), matrix, D, (int(size[0]), int(size[1])), fisheye=fisheye)
    return Calibration((camera,))


_D = ("distortion_coefficients", "D", "d")


def _refuse_part(path: Path, content: dict[str, Any]) -> None:
    """Raise CalibrationError if pictures are binned or cut out: K then is that of larger ones."""
    roi = content.get("roi")
    offsets = [roi.get(key) for key in ("x_offset", "y_offset")] if isinstance(roi, dict) else []
    binned = any(content.get(key) not in (None, 0, 1) for key in ("binning_x", "binning_y"))
    if binned or any(offset not in (None, 0) for offset in offsets):
        raise CalibrationError(
            f"{path}: of binned pictures or a region of interest; calibrate pictures as recorded"
        )


def rig(primary: tuple[Path, bytes], assistant: tuple[Path, bytes]) -> Float | None:
    """T_p_a (4, 4) [m] of the paths and contents of two files; None if they are no stereo pair."""
    R, P = [], []
    for path, data in (primary, assistant):
        content = parsed_yaml(path, data)
        rotation = _values(content, "rectification_matrix", "R", "r")
        projection = _values(content, "projection_matrix", "P", "p")
        if rotation is None or projection is None:
            return None
        R.append(np.array(numbers(str(path), "R", rotation, (9,))).reshape(3, 3))
        P.append(np.array(numbers(str(path), "P", projection, (12,))).reshape(3, 4))
    if any(abs(np.linalg.det(rotation) - 1) > 1e-3 for rotation in R):
        return None
    focals = [np.array([each[0, 0], each[1, 1]]) for each in P]
    if any((focal <= 0).any() for focal in focals):
        return None
    # of the pair of which one is at the origin: the assistant may be the left camera
    at = [-each[:2, 3] / focal for each, focal in zip(P, focals, strict=True)]
    baseline = np.array([*(at[1] - at[0]), 0.0])
    if not np.linalg.norm(baseline) > 0:
        return None
    return se3.compose(R[0].T @ R[1], R[0].T @ baseline)


def write(folder: Path, calibration: Calibration, notes: tuple[str, ...]) -> list[Path]:
    """Write one file per camera; with a rig, R and P rectify the pair."""
    R, P = _rectified(calibration)
    comment = "".join(f"# {note}\n" for note in notes)
    files = []
    for name, each, rotation, projection in zip(NAMES, calibration.cameras, R, P, strict=False):
        lens = each.camera
        model, k = distortion_of(lens)
        content = {
            "image_width": lens.width,
            "image_height": lens.height,
            "camera_name": name,
            "camera_matrix": _matrix(lens.matrix),
            "distortion_model": model,
            "distortion_coefficients": _matrix(np.array([k])),
            "rectification_matrix": _matrix(rotation),
            "projection_matrix": _matrix(projection),
        }
        path = folder / f"{name}.yaml"
        path.write_text(comment + yaml.safe_dump(content, sort_keys=False, default_flow_style=None))
        files.append(path)
    return files


def distortion_of(camera: Camera) -> tuple[str, list[float]]:
    """Name of a camera's distortion model and its coefficients, as in camera_info."""
    k = coefficients(camera)
    if isinstance(camera, Fisheye):
        return "equidistant", k
    if len(k) == 4:
        k.append(0.0)  # camera_info has 5 coefficients
    return ("plumb_bob" if len(k) < 8 else "rational_polynomial"), k


def _rectified(calibration: Calibration) -> tuple[list[Float], list[Float]]:
    """Matrices R (3, 3) and P (3, 4) of each camera."""
    lenses = [each.camera for each in calibration.cameras]
    if calibration.T_p_a is None or len(lenses) < 2:
        P = [np.hstack([lens.matrix, np.zeros((3, 1))]) for lens in lenses]
        return [np.eye(3)] * len(lenses), P
    T_a_p, size = se3.inverse(calibration.T_p_a), (lenses[0].width, lenses[0].height)
    # the distortion matters for P alone, and cv2 has no pairs with one fisheye lens
    k_p, k_a = (
        np.zeros(4) if isinstance(lens, Fisheye) else np.array(coefficients(lens))
        for lens in lenses
    )
    R_p, R_a, P_p, P_a = cv2.stereoRectify(
        lenses[0].matrix, k_p, lenses[1].matrix, k_a, size, T_a_p[:3, :3], T_a_p[:3, 3:], alpha=0
    )[:4]
    return [np.asarray(R_p), np.asarray(R_a)], [np.asarray(P_p), np.asarray(P_a)]


def _matrix(values: Float) -> dict[str, Any]:
    rows, cols = values.shape
    return {"rows": rows, "cols": cols, "data": values.ravel().tolist()}


def _first(content: dict[str, Any], *keys: str) -> Any:
    return next((content[key] for key in keys if key in content), None)


def _values(content: dict[str, Any], *keys: str) -> Any:
    """A matrix of the file, which is a list or a table with `data`; None if absent."""
    value = _first(content, *keys)
    return value.get("data") if isinstance(value, dict) else value
