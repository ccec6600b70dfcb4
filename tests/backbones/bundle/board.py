"""Paste a board that moves by itself, such as the back of a van, into pictures of known cameras."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera
from calm_edge.types import Bytes, Float

TEXELS = 96


def texture(seed: int = 0) -> Bytes:
    """Blotches of several sizes (TEXELS, TEXELS, 3)."""
    rng = np.random.default_rng(seed)
    out = np.zeros((TEXELS, TEXELS), np.float32)
    for sigma in (1.5, 4.0, 9.0):
        noise = cv2.GaussianBlur(rng.standard_normal(out.shape).astype(np.float32), (0, 0), sigma)
        out += noise / noise.std()
    return np.repeat(np.clip(128 + 38 * out, 0, 255).astype(np.uint8)[:, :, None], 3, 2)


def pasted(
    images: Sequence[Bytes],
    cameras: Sequence[Camera],
    T_w_c: Float,
    T_w_board: Float,
    size: tuple[float, float],
) -> tuple[list[Bytes], Bytes]:
    """Pictures with the board, and where it is (N, H, W) bool.

    T_w_c, T_w_board: (N, 4, 4) of each picture; the board is centred in the plane z = 0 of its
    axes. size: its width and height.
    """
    paint, corners = texture(), np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / 2
    p_b = np.c_[corners * size, np.zeros(4)]
    texels = np.asarray((corners + 0.5) * (TEXELS - 1), np.float32)
    out, covers = [], []
    for image, camera, T_w, T_board in zip(images, cameras, T_w_c, T_w_board, strict=True):
        p_c = se3.transform(se3.inverse(T_w) @ T_board, p_b)
        cover = np.zeros(image.shape[:2], np.uint8)
        mixed = image
        if (p_c[:, 2] > 0.5).all():
            H = cv2.getPerspectiveTransform(texels, camera.project(p_c).astype(np.float32))
            width, height = camera.width, camera.height
            seen = cv2.warpPerspective(paint, H, (width, height), flags=cv2.INTER_AREA)
            full = np.full(paint.shape[:2], 255, np.uint8)
            cover = cv2.warpPerspective(full, H, (width, height), flags=cv2.INTER_NEAREST)
            mixed = np.where(cover[..., None] > 0, seen, image)
        out.append(mixed)
        covers.append(cover > 0)
    return out, np.array(covers)
