"""Recognise that two cameras deliver the same pictures: one camera read twice, or a splitter.

Two cameras at different places differ in their pictures by parallax, at least near the ground, and
by their mounting; one camera's pictures agree everywhere, up to coding, size and brightness.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.uint8]


# Pictures are reduced to this size and divided into BLOCKS; a block with a smaller standard
# deviation than LEAST_CONTRAST has no texture to compare.
SIZE = (192, 108)
BLOCKS = (6, 4)
LEAST_CONTRAST = 3.0
MIN_BLOCKS = 6
# A twin has a larger correlation coefficient than this in the block that ranks at QUANTILE.
TWIN_CORRELATION, QUANTILE = 0.93, 0.1
# Assistant pictures needed, and the share of them that have a twin.
MIN_PICTURES, TWIN_SHARE = 3, 0.5


def look_alike(primary: Sequence[Picture], assistant: Sequence[Picture]) -> bool:
    """Whether half of the assistant's pictures or more are also ones of the primary.

    At any of the given instants: the copy may be delayed. Pictures are (H, W) or (H, W, 3) BGR;
    their sizes may differ.
    """
    if len(assistant) < MIN_PICTURES:
        return False
    P, with_texture = _blocks(primary)
    A, also = _blocks(assistant)
    twins = 0
    for blocks, textured in zip(A, also, strict=True):
        correlation = (blocks * P).mean(-1)
        for row, known in zip(correlation, with_texture & textured, strict=True):
            if known.sum() >= MIN_BLOCKS and np.quantile(row[known], QUANTILE) > TWIN_CORRELATION:
                twins += 1
                break
    return twins >= max(MIN_PICTURES, TWIN_SHARE * len(assistant))


def _blocks(pictures: Sequence[Picture]) -> tuple[np.ndarray, np.ndarray]:
    """Blocks (N, B, pixels) of mean 0 and standard deviation 1, and which have texture (N, B)."""
    columns, rows = BLOCKS
    small = [cv2.resize(p, SIZE, interpolation=cv2.INTER_AREA) for p in pictures]
    small = [cv2.cvtColor(p, cv2.COLOR_BGR2GRAY) if p.ndim == 3 else p for p in small]
    # against the noise of coding
    soft = np.stack([cv2.GaussianBlur(p.astype(np.float32), (0, 0), 1.0) for p in small])
    width, height = SIZE[0] // columns, SIZE[1] // rows
    split = soft.reshape(len(soft), rows, height, columns, width).transpose(0, 1, 3, 2, 4)
    blocks = split.reshape(len(soft), rows * columns, -1).astype(np.float64)
    blocks -= blocks.mean(-1, keepdims=True)
    contrast = blocks.std(-1)
    return blocks / np.maximum(contrast, 1e-9)[..., None], contrast > LEAST_CONTRAST
