"""Lenses behind which scripted drives are seen: the field of view of the pinhole camera, bent."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict

import numpy as np

from calm_edge.config import CalibratedCameraConfig, CalibrationConfig
from calm_edge.geometry.camera import Camera, Perspective
from calm_edge.geometry.fisheye import Fisheye

# k1, k2 of a usual wide lens, and field of view [deg] of the fisheye lens across the picture.
BARREL = (-0.25, 0.06)
FISHEYE_HFOV_DEG = 110.0


def barrel(camera: Perspective) -> Camera:
    """A perspective lens with barrel distortion and the camera's horizontal field of view."""
    r = camera.width / 2 / camera.fx
    f = camera.width / 2 / (r * (1 + BARREL[0] * r**2 + BARREL[1] * r**4))
    return Perspective(f, f, camera.cx, camera.cy, camera.width, camera.height, BARREL)


def fisheye(camera: Perspective) -> Camera:
    """An equidistant fisheye lens of FISHEYE_HFOV_DEG, whatever the camera's field of view."""
    f = camera.width / np.radians(FISHEYE_HFOV_DEG)
    return Fisheye(float(f), float(f), camera.cx, camera.cy, camera.width, camera.height)


LENSES: dict[str, Callable[[Perspective], Camera]] = {"barrel": barrel, "fisheye": fisheye}


def calibration_of(cameras: Sequence[Camera]) -> CalibrationConfig:
    """Cameras, perspective or fisheye, as a calibration that is given to `record`."""
    return CalibrationConfig(
        cameras=tuple(
            CalibratedCameraConfig(
                model="fisheye" if isinstance(camera, Fisheye) else "perspective", **asdict(camera)
            )
            for camera in cameras
        )
    )
