"""Recognise pictures that repeat an earlier one under a new stamp: they are no exposures.

Webcam firmware, rate conversion of videos and USB bridges repeat pictures. Taken for exposures, a
moving car seems to stand still for one frame and to move twice as far in the next.
"""

from __future__ import annotations

import cv2
import numpy as np

from calm_edge.types import Bytes, Float32

# A picture coded anew differs from itself by up to 0.015, one exposed later by 0.04 or more while
# the car moves; a braking car's change falls by less than a factor of 3 from one to the next.
MAX_CHANGE, MAX_RATIO = 0.03, 0.1
# For so long a picture that hardly changes is taken for a repeat; a longer time is a standstill.
STANDSTILL_NS = 250_000_000
# Grey levels; without contrast (darkness, a covered lens) there is nothing to compare.
LEAST_CONTRAST = 1.0


class RepeatCheck:
    """Compares each picture of one camera with the last one that was exposed."""

    def __init__(self) -> None:
        self._image = b""
        self._small: Float32 = np.zeros((0, 0), np.float32)
        self._change = 0.0
        self._t_ns = 0

    def is_repeat(self, t_ns: int, image: bytes, gray: Bytes) -> bool:
        """Whether the picture repeats the last one: exactly, or coded anew while the car moves.

        image: coded as received. gray: decoded, 1/8 of its size in each direction.
        """
        small, change = _normalised(gray), np.inf
        if small is None:
            self._image = b""
            return False
        if image == self._image:
            return True
        if small.shape == self._small.shape and self._image:
            change = float(np.linalg.norm(small - self._small))
            if not change:
                return True
            soon = t_ns - self._t_ns < STANDSTILL_NS
            if soon and change < min(MAX_CHANGE, MAX_RATIO * self._change):
                return True
        self._image, self._small, self._t_ns = image, small, t_ns
        self._change = change if np.isfinite(change) else 0.0
        return False


def eighth(gray: Bytes, reduction: int = 1) -> Bytes:
    """Reduce a picture, already at 1 / `reduction` (1 or 2), to 1/8 of its size."""
    scale = reduction / 8
    return np.asarray(
        cv2.resize(gray, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8
    )


def _normalised(gray: Bytes) -> Float32 | None:
    """The picture with mean 0 and norm 1; None without contrast."""
    centred = gray.astype(np.float32)
    centred -= centred.mean()
    norm = float(np.linalg.norm(centred))
    if norm < LEAST_CONTRAST * np.sqrt(gray.size):
        return None
    return centred / np.float32(norm)
