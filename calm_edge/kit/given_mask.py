"""Masks given as images, as text in the configuration, so that `map` needs no files."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from calm_edge.config import CaptureConfig, ConfigError
from calm_edge.geometry.picture_mask import grid
from calm_edge.types import Bytes, Masks

# Cells along the long side that an image is reduced to.
CELLS = 64
# A mask that leaves a smaller share of the picture is refused.
LEAST_USED = 0.25


def cells_of(image: NDArray[np.uint8]) -> Bytes:
    """Cells (rows, columns), 1 where most of a grey image (H, W) is black, i.e. left out.

    Raises ValueError if too little is left.
    """
    height, width = image.shape
    size = shape_for(width, height)[::-1]
    black = (image < 128).astype(np.float32)
    cells = (cv2.resize(black, size, interpolation=cv2.INTER_AREA) > 0.5).astype(np.uint8)
    if cells.mean() > 1 - LEAST_USED:
        raise ValueError(f"it leaves {100 * (1 - cells.mean()):.0f} % of the picture")
    return cells


def shape_for(width: int, height: int) -> tuple[int, int]:
    """Rows and columns for pictures of a size [px]."""
    return grid(width, height, CELLS)


def encoded(cells: Bytes) -> str:
    """Text ROWSxCOLUMNS:HEX of a mask."""
    rows, columns = cells.shape
    return f"{rows}x{columns}:{np.packbits(cells.ravel()).tobytes().hex()}"


def decoded(text: str) -> Bytes | None:
    """The mask of `encoded`; None for an empty text. Raises ConfigError."""
    if not text:
        return None
    try:
        shape, data = text.split(":")
        rows, columns = (int(n) for n in shape.split("x"))
        bits = np.unpackbits(np.frombuffer(bytes.fromhex(data), np.uint8))
        if min(rows, columns) < 1 or not 0 <= len(bits) - rows * columns < 8:
            raise ValueError
    except ValueError:
        raise ConfigError(
            "capture.mask_cells: not a mask; give the image with capture.mask"
        ) from None
    return bits[: rows * columns].reshape(rows, columns)


def masks_of(config: CaptureConfig) -> Masks:
    """Masks of both eyes as configured; raises ConfigError."""
    texts = (*config.mask_cells, "", "")
    return Masks(decoded(texts[0]), decoded(texts[1]))
