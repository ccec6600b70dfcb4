"""Pictures with what is left out of them shaded."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from calm_edge.geometry import picture_mask
from calm_edge.types import Bytes, Masks

WIDTH_PX = 480
# share of this colour (RGB) in the parts left out
SHADE, SHARE = np.array([220, 40, 40]), 0.55


def shaded(pictures: Sequence[Bytes | None], masks: Masks | None) -> tuple[Bytes, ...]:
    """Small pictures (h, w, 3) RGB of the eyes that have a mask.

    pictures: (H, W, 3) BGR of each eye, or None.
    """
    out = []
    for eye, picture in enumerate(pictures):
        mask = None if masks is None else masks.of_eye(eye)
        if mask is None or picture is None:
            continue
        height = max(1, round(picture.shape[0] * WIDTH_PX / picture.shape[1]))
        small = cv2.resize(picture, (WIDTH_PX, height), interpolation=cv2.INTER_AREA)[..., ::-1]
        left_out = picture_mask.stretched(mask, (height, WIDTH_PX))[..., None]
        mixed = SHARE * SHADE + (1 - SHARE) * small
        out.append(np.where(left_out, mixed, small).astype(np.uint8))
    return tuple(out)
