"""Degrade pictures by night, motion blur or JPEG, repeatably by a seed."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from calm_edge.types import Bytes

Degrade = Callable[[Bytes, int], Bytes]

# Electrons of a white pixel, read noise [electrons], and brightness of the result.
NIGHT_WHITE, NIGHT_READ, NIGHT_LEVEL = 300.0, 5.0, 0.4
GAMMA = 2.2
BLUR_SHARE = 1 / 80  # length of the blur line as a share of the picture's width
JPEG_QUALITY = 50


def night(image: Bytes, seed: int) -> Bytes:
    """Simulate night: shot and read noise of a dark scene, gain and gamma. (H, W, 3) BGR."""
    rng = np.random.default_rng((seed, 1))
    electrons = NIGHT_WHITE * (image / 255.0) ** GAMMA
    read = rng.poisson(electrons) + rng.normal(0.0, NIGHT_READ, image.shape)
    level = NIGHT_LEVEL * np.clip(read / NIGHT_WHITE, 0, 1 / NIGHT_LEVEL)
    return np.asarray(np.round(255 * level ** (1 / GAMMA)), np.uint8)


def motion_blur(image: Bytes, seed: int) -> Bytes:
    """Blur along a line in a random direction. (H, W, 3) BGR.

    The line has a length of BLUR_SHARE of the width.
    """
    length = max(3, round(image.shape[1] * BLUR_SHARE)) | 1
    angle = np.random.default_rng((seed, 2)).uniform(0, 180)
    line = np.zeros((length, length), np.float32)
    line[length // 2] = 1
    turn = cv2.getRotationMatrix2D((length // 2, length // 2), angle, 1)
    kernel = cv2.warpAffine(line, turn, (length, length), flags=cv2.INTER_LINEAR)
    return np.asarray(cv2.filter2D(image, -1, kernel / kernel.sum()), np.uint8)


def jpeg(image: Bytes, _seed: int) -> Bytes:
    """Encode as JPEG of JPEG_QUALITY and decode again. (H, W, 3) BGR."""
    _, packed = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return np.asarray(cv2.imdecode(packed, cv2.IMREAD_COLOR), np.uint8)


DEGRADATIONS: dict[str, Degrade] = {"night": night, "blur": motion_blur, "jpeg 50": jpeg}
