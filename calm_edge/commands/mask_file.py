"""Mask images of a configuration: read into it, and compared with the pictures."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from calm_edge.commands.calibration_file import picture_size
from calm_edge.config import Config, ConfigError, merge
from calm_edge.kit.calibration import EYES
from calm_edge.kit.given_mask import cells_of, encoded, masks_of, shape_for
from calm_edge.recording.reader import Recording
from device.frame import Eye


def with_masks(config: Config) -> Config:
    """Read `capture.mask` into `capture.mask_cells`; raises ConfigError."""
    names = config.capture.mask
    if len(names) > 2:
        raise ConfigError(f"capture.mask = {list(names)}: give one image per camera")
    return merge(
        config, {"capture": {"mask_cells": [_read(name) if name else "" for name in names]}}
    )


def _read(name: str) -> str:
    try:
        data = np.frombuffer(Path(name).read_bytes(), np.uint8)
    except OSError as error:
        raise ConfigError(f"capture.mask: {name}: cannot be read ({error.strerror})") from None
    image = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE) if len(data) else None
    if image is None:
        raise ConfigError(f"capture.mask: {name}: not an image; give a PNG or JPEG")
    try:
        return encoded(cells_of(np.asarray(image, np.uint8)))
    except ValueError as error:
        raise ConfigError(
            f"capture.mask: {name}: {error}; black is left out, white is used"
        ) from None


def refuse_other_shapes(config: Config, sequence: Path | None, recording: Recording | None) -> None:
    """Raise ConfigError if a mask does not have the aspect ratio of its pictures.

    sequence, recording: what is replayed; otherwise the size is the configured one.
    """
    masks = masks_of(config.capture)
    for eye in Eye:
        mask = masks.of_eye(eye)
        if mask is None:
            continue
        width, height = picture_size(config, eye, sequence, recording)
        if mask.shape != shape_for(width, height):
            rows, columns = mask.shape
            raise ConfigError(
                f"capture.mask: that of the {EYES[eye]} has {columns} x {rows} cells, its pictures "
                f"of {width} x {height} px need another aspect ratio"
            )
