"""Pictures in a terminal: two pixels a character, by the upper half block in 24-bit colours."""

from __future__ import annotations

import cv2
import numpy as np

from calm_edge.types import Bytes

HALF_BLOCK, RESET = "\u2580", "\x1b[0m"
GAP_PX = 2


def side_by_side(left: Bytes, right: Bytes, width: int) -> Bytes:
    """Two pictures (H, W, 3) beside each other, each `width` px wide, with a black gap."""
    halves = []
    for picture in (left, right):
        height = max(2, round(picture.shape[0] * width / picture.shape[1]))
        halves.append(cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA))
    tallest = max(half.shape[0] for half in halves)
    joined = np.zeros((tallest, 2 * width + GAP_PX, 3), np.uint8)
    for half, x in zip(halves, (0, width + GAP_PX), strict=True):
        joined[: half.shape[0], x : x + width] = half
    return joined


def lines(picture: Bytes) -> list[str]:
    """Lines of text that show a picture (H, W, 3) BGR, a character for each column."""
    height = picture.shape[0] // 2 * 2
    found = []
    for row in range(0, height, 2):
        cells = zip(picture[row].tolist(), picture[row + 1].tolist(), strict=True)
        text = "".join(
            f"\x1b[38;2;{r};{g};{b};48;2;{r2};{g2};{b2}m{HALF_BLOCK}"
            for (b, g, r), (b2, g2, r2) in cells
        )
        found.append(text + RESET)
    return found
