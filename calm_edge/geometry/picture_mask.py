"""Masks of pictures: arrays (h, w) uint8 of any size that cover the picture, not 0: left out."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from calm_edge.geometry.flow import Gray


def grid(width: int, height: int, cells: int) -> tuple[int, int]:
    """Rows and columns of about square cells of a picture [px], `cells` along its long side."""
    side = max(width, height) / cells
    return max(1, round(height / side)), max(1, round(width / side))


def inside(mask: Gray, uv: NDArray[np.floating], size: tuple[int, int]) -> NDArray[np.bool_]:
    """Whether pixels uv (N, 2) of a picture of size (width, height) are left out, (N,)."""
    height, width = mask.shape
    cell = np.floor((uv + 0.5) * (np.array([width, height]) / np.array(size))).astype(np.int64)
    column, row = np.clip(cell, 0, [width - 1, height - 1]).T
    return np.asarray(mask[row, column] > 0)


def stretched(mask: Gray, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Pixels (H, W) of a picture or depth map of `shape` that are left out."""
    height, width = shape
    large = cv2.resize(mask, (width, height), interpolation=cv2.INTER_NEAREST)
    return np.asarray(large > 0)


def kept(mask: Gray, shape: tuple[int, int]) -> Gray:
    """The opposite, as OpenCV wants it: (H, W), 255 where the picture is used, 0 elsewhere."""
    return np.where(stretched(mask, shape), 0, 255).astype(np.uint8)
