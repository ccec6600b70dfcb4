"""Scale a sub-map to images of half the size, at which large images are tracked."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calm_edge.geometry.camera import Camera
from calm_edge.types import LocalizerUpdate

# larger images are halved: tracking 1280x720 at 30 Hz takes more than one core
MAX_PIXELS = 600_000


def halved(update: LocalizerUpdate) -> LocalizerUpdate:
    """Convert cameras and pixels to images of half the size; poses are unchanged."""
    submap, prediction = update.submap, update.prediction
    marks = prediction.landmarks
    if marks is not None:
        uv = np.asarray((marks.uv + 0.5) / 2 - 0.5, np.float32)
        sigma_px = None if marks.sigma_px is None else marks.sigma_px / np.float32(2)
        marks = replace(marks, uv=uv, sigma_px=sigma_px)
    prediction = replace(prediction, cameras=_half(prediction.cameras), landmarks=marks)
    cameras, raw = _half(submap.cameras), _half(submap.cameras_raw)
    submap = replace(submap, cameras=cameras, cameras_raw=raw)
    return replace(update, submap=submap, prediction=prediction)


def _half(cameras: tuple[Camera, ...]) -> tuple[Camera, ...]:
    return tuple(camera.scaled(0.5, 0.5) for camera in cameras)
