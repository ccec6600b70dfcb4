"""The table of calibration formats; a file's format is recognised by its content."""

from __future__ import annotations

from pathlib import Path

from calm_edge.interchange.calibration import colmap, kalibr, opencv, ros
from calm_edge.interchange.calibration.calibration import (
    Calibration,
    CalibrationError,
    CalibrationFormat,
    joined,
)

# `recognises` is asked in this order
FORMATS: dict[str, CalibrationFormat] = {
    "opencv": opencv,
    "kalibr": kalibr,
    "ros": ros,
    "colmap": colmap,
}


def read(paths: tuple[Path, ...]) -> Calibration:
    """Read a calibration of both cameras, or one file each; raises CalibrationError."""
    parts: list[tuple[Path, Calibration]] = []
    files: list[tuple[Path, bytes]] = []
    names: list[str] = []
    for path in paths:
        try:
            data = path.read_bytes()
        except OSError as error:
            raise CalibrationError(f"{path}: cannot be read ({error.strerror})") from None
        names.append(format_of(path, data))
        files.append((path, data))
        parts.append((path, FORMATS[names[-1]].read(path, data)))
    calibration = joined(parts)
    if names == ["ros", "ros"]:
        rig = ros.rig(files[0], files[1])
        return Calibration(calibration.cameras, rig, metric=rig is not None)
    return calibration


def format_of(path: Path, data: bytes) -> str:
    """Name of a file's format; raises CalibrationError."""
    for name, each in FORMATS.items():
        if each.recognises(path, data):
            return name
    raise CalibrationError(
        f"{path}: not a calibration of OpenCV (YAML, XML), ROS (camera_info), Kalibr (camchain) "
        "or COLMAP (cameras.txt, cameras.bin)"
    )


def write(
    name: str, folder: Path, calibration: Calibration, notes: tuple[str, ...] = ()
) -> list[Path]:
    """Write a calibration to a folder in a format of FORMATS; return the files.

    notes: comments. An existing file is never overwritten. Raises CalibrationError.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()):
            raise CalibrationError(f"{folder}: is not empty; choose another output folder")
        return FORMATS[name].write(folder, calibration, notes)
    except OSError as error:
        raise CalibrationError(f"{folder}: cannot be written ({error.strerror})") from None
