"""OpenCV's YAML or XML of `cv::FileStorage`: one camera, or both of a stereo calibration.

Keys of one camera, as of OpenCV's calibration sample: image_width, image_height, camera_matrix,
distortion_coefficients, and fisheye_model if 1. Of two, as of its stereo sample: M1, D1, M2, D2,
and R, T, which take points of the first camera to the second; image_width and image_height, or with
the suffix 1 and 2, have to be added there. xi: a camera of the omnidir module.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera, Perspective
from calm_edge.geometry.fisheye import Fisheye
from calm_edge.interchange.calibration.calibration import (
    CalibratedCamera,
    Calibration,
    CalibrationError,
    checked,
)
from calm_edge.interchange.calibration.fields import numbers, rigid
from calm_edge.interchange.calibration.fit import fitted
from calm_edge.interchange.calibration.lens import Lens, Pinhole, brown_with_prism, unified
from calm_edge.types import Float

FILE = "opencv.yml"
_MATRIX = ("camera_matrix", "cameraMatrix", "K", "M")
_DISTORTION = ("distortion_coefficients", "distCoeffs", "dist_coeffs", "D")
_MARKS = (b"%YAML:1.0", b"!!opencv-matrix", b"<opencv_storage>", b"opencv-matrix")


def recognises(path: Path, data: bytes) -> bool:
    """Whether the file has one of the marks that FileStorage writes."""
    return any(mark in data for mark in _MARKS)


def read(path: Path, data: bytes) -> Calibration:
    """Read the cameras and, of a stereo calibration, the rig."""
    try:
        storage = cv2.FileStorage(data.decode(), cv2.FileStorage_READ | cv2.FileStorage_MEMORY)
        opened = storage.isOpened()
    except (cv2.error, SystemError, UnicodeDecodeError):
        opened = False
    if not opened:
        raise CalibrationError(f"{path}: not a YAML or XML file that OpenCV can read")
    numbered = [suffix for suffix in ("1", "2") if _matrix(storage, _MATRIX, suffix) is not None]
    cameras = tuple(_camera(path, storage, suffix) for suffix in numbered or [""])
    R, T = (_matrix(storage, (key,), "") for key in "RT")
    if len(cameras) < 2 or R is None or T is None:
        return Calibration(cameras)
    if R.size == 3:
        R = np.asarray(cv2.Rodrigues(R)[0], np.float64)
    if R.shape != (3, 3) or T.size != 3:
        raise CalibrationError(f"{path}: R and T are not a rotation and a translation")
    return Calibration(cameras, se3.inverse(rigid(str(path), "R, T", R, T.ravel())))


def write(folder: Path, calibration: Calibration, notes: tuple[str, ...]) -> list[Path]:
    """Write all cameras to one YAML file, with the keys of a stereo calibration."""
    storage = cv2.FileStorage(
        "", cv2.FileStorage_WRITE | cv2.FileStorage_MEMORY | cv2.FileStorage_FORMAT_YAML
    )
    for note in notes:
        storage.writeComment(note)
    one = len(calibration.cameras) == 1
    for number, each in enumerate(calibration.cameras, 1):
        lens, suffix = each.camera, "" if one else str(number)
        storage.write(f"image_width{suffix}", lens.width)
        storage.write(f"image_height{suffix}", lens.height)
        storage.write("camera_matrix" if one else f"M{suffix}", lens.matrix)
        terms = np.array([coefficients(lens)])
        storage.write("distortion_coefficients" if one else f"D{suffix}", terms)
        storage.write(f"fisheye_model{suffix}", int(isinstance(lens, Fisheye)))
    if calibration.T_p_a is not None:
        T_a_p = se3.inverse(calibration.T_p_a)
        storage.write("R", T_a_p[:3, :3])
        storage.write("T", T_a_p[:3, 3:])
    # of its own it writes YAML 1.2, which OpenCV before 5 does not read
    text = storage.releaseAndGetString().replace("%YAML 1.2", "%YAML:1.0", 1)
    path = folder / FILE
    path.write_text(text)
    return [path]


def coefficients(lens: Camera) -> list[float]:
    """Distortion coefficients filled up to a number that OpenCV takes: 4, 5 or 8."""
    least = 4 if isinstance(lens, Fisheye) or len(lens.distortion) <= 4 else 5
    wanted = least if len(lens.distortion) <= least else 8
    return [*map(float, lens.distortion), *[0.0] * (wanted - len(lens.distortion))]


def distorted_camera(
    where: str, matrix: Pinhole, k: list[float], size: tuple[int, int], *, fisheye: bool
) -> CalibratedCamera:
    """Camera of fx, fy, cx, cy, of OpenCV's coefficients and the size; raises CalibrationError."""
    fx, fy, cx, cy = matrix
    if fisheye:
        if len(k) != 4:
            raise CalibrationError(f"{where}: a fisheye lens has 4 coefficients, not {len(k)}")
        try:
            lens = Fisheye(fx, fy, cx, cy, *size, tuple(k))
        except ValueError as error:
            raise CalibrationError(f"{where}: {error}") from None
        return checked(where, CalibratedCamera(lens, "fisheye"))
    if len(k) not in (0, 4, 5, 8, 12, 14):
        raise CalibrationError(
            f"{where}: {len(k)} distortion coefficients; OpenCV has 4, 5, 8, 12 or 14"
        )
    if any(k[8:]):
        prism = Lens(brown_with_prism(k), fx, fy, cx, cy, *size)
        camera, off_px = fitted(where, prism)
        return checked(where, CalibratedCamera(camera, "perspective with thin prism", off_px))
    kept = np.trim_zeros(np.array(k[:8]), "b")
    camera = Perspective(fx, fy, cx, cy, *size, tuple(kept.tolist()))
    return checked(where, CalibratedCamera(camera, "rational" if len(kept) > 5 else "plumb_bob"))


def _camera(path: Path, storage: cv2.FileStorage, suffix: str) -> CalibratedCamera:
    where = f"{path}: camera {suffix}" if suffix else str(path)
    matrix, terms = (_matrix(storage, names, suffix) for names in (_MATRIX, _DISTORTION))
    if matrix is None or matrix.shape != (3, 3):
        raise CalibrationError(f"{path}: no camera_matrix, or M1 and M2, of 3 x 3 numbers in it")
    size = _size(path, storage, suffix)
    K = np.array(numbers(where, "its matrix", matrix)).reshape(3, 3)
    pinhole: Pinhole = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    k = [] if terms is None else numbers(where, "its distortion", terms)
    xi = _number(storage, "xi", suffix)
    if xi is not None:
        camera, off_px = fitted(where, Lens(unified(xi, k[:4]), *pinhole, *size))
        return checked(where, CalibratedCamera(camera, "omnidir", off_px))
    fisheye = bool(_number(storage, "fisheye_model", suffix))
    return distorted_camera(where, pinhole, k, size, fisheye=fisheye)


def _size(path: Path, storage: cv2.FileStorage, suffix: str) -> tuple[int, int]:
    size = []
    for key in ("image_width", "image_height"):
        value = _number(storage, key, suffix)
        if value is None:
            raise CalibrationError(
                f"{path}: without the size of its pictures; add image_width and image_height"
            )
        size.append(int(value))
    return size[0], size[1]


def _number(storage: cv2.FileStorage, key: str, suffix: str) -> float | None:
    """A number by its key with the suffix, else without it."""
    for name in (key + suffix, key):
        node = storage.getNode(name)
        if node.isInt() or node.isReal():
            return float(node.real())
        if node.isMap() and (value := node.mat()) is not None and value.size == 1:
            return float(value.flat[0])
    return None


def _matrix(storage: cv2.FileStorage, names: tuple[str, ...], suffix: str) -> Float | None:
    """A matrix, or a list of numbers, by any of its names; None if there is none."""
    for name in names:
        node = storage.getNode(name + suffix)
        if node.isMap():
            try:
                value = node.mat()
            except (cv2.error, SystemError):
                continue
            if value is not None:
                return np.asarray(value, np.float64)
        if node.isSeq():
            return np.array([[node.at(i).real() for i in range(node.size())]])
    return None
