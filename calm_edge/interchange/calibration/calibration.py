"""A calibration of one or two cameras, as read from a file or to be written to one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from calm_edge.geometry.camera import Camera
from calm_edge.types import CalmEdgeError, Float

# Largest share of the picture's pixels at which a lens model may have no inverse.
MAX_FOLDED = 0.05
# Columns and rows of pixels at which that is tested.
GRID = 33, 25


class CalibrationError(CalmEdgeError):
    """A calibration that cannot be read, used or written."""


@dataclass(frozen=True, slots=True)
class CalibratedCamera:
    """A camera; `fit_px` is its largest difference over the picture to the file's own model.

    0 if the file's model is that of the camera. model: as the file names it.
    """

    camera: Camera
    model: str
    fit_px: float = 0.0


@dataclass(frozen=True, slots=True)
class Calibration:
    """Cameras: the primary, then the assistant if it is calibrated.

    T_p_a: (4, 4), assistant to primary, or None. metric: T_p_a is in metres, not in a unit of its
    own.
    """

    cameras: tuple[CalibratedCamera, ...]
    T_p_a: Float | None = None
    metric: bool = False

    @property
    def spacing_m(self) -> float | None:
        """Distance between the cameras in metres, if the calibration has it."""
        if self.T_p_a is None or not self.metric:
            return None
        return float(np.linalg.norm(self.T_p_a[:3, 3]))


class CalibrationFormat(Protocol):
    """A file format, implemented by a module."""

    def recognises(self, path: Path, data: bytes) -> bool:
        """Whether a file is of this format; its content may still be wrong."""

    def read(self, path: Path, data: bytes) -> Calibration:
        """All cameras of a file in its own order; raises CalibrationError."""

    def write(self, folder: Path, calibration: Calibration, notes: tuple[str, ...]) -> list[Path]:
        """Write a calibration to an existing folder; return the files.

        notes: lines to store as comments. Raises CalibrationError for a lens that the format cannot
        hold, OSError if the folder is not writable.
        """


def checked(where: str, each: CalibratedCamera) -> CalibratedCamera:
    """Check that numbers are possible and that the lens has an inverse; raises CalibrationError.

    where: file, and camera in it, for the message.
    """
    camera = each.camera
    numbers = [camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion]
    if not np.isfinite(numbers).all() or min(camera.fx, camera.fy) <= 0:
        raise CalibrationError(f"{where}: focal length {camera.fx:g}, {camera.fy:g} px is no lens")
    if min(camera.width, camera.height) < 1:
        raise CalibrationError(f"{where}: picture size {camera.width} x {camera.height} px")
    if not (0 <= camera.cx < camera.width and 0 <= camera.cy < camera.height):
        raise CalibrationError(
            f"{where}: principal point ({camera.cx:.0f}, {camera.cy:.0f}) outside of its picture "
            f"of {camera.width} x {camera.height} px; give the size at which it was calibrated"
        )
    folded = float(np.isnan(camera.rays(camera.pixel_grid(*GRID))).any(-1).mean())
    if folded > MAX_FOLDED:
        raise CalibrationError(
            f"{where}: the lens model has no inverse in {100 * folded:.0f} % of the picture; "
            "calibrate with fewer terms or as a fisheye lens"
        )
    return each


def joined(parts: list[tuple[Path, Calibration]]) -> Calibration:
    """Join one or two files' cameras, the primary first; raises CalibrationError.

    A rig is taken from a file that holds both cameras.
    """
    if len(parts) > 2:
        raise CalibrationError(f"{parts[2][0]}: give one calibration file, or one per camera")
    path, first = parts[0]
    if len(parts) == 1:
        if len(first.cameras) > 2:
            raise CalibrationError(
                f"{path}: holds {len(first.cameras)} cameras; keep the two of the kit, "
                "the primary first"
            )
        return first
    for path, each in parts:
        if len(each.cameras) != 1:
            raise CalibrationError(
                f"{path}: holds {len(each.cameras)} cameras; beside another file it must hold one"
            )
    return Calibration(first.cameras + parts[1][1].cameras)
