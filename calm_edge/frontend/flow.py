"""Corners and where they went: Shi-Tomasi and pyramidal Lucas-Kanade with a backward check."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from calm_edge.types import Bytes, Float32

WINDOW = (21, 21)
LEVELS = 3
BACKWARD_PX = 0.7
CRITERIA = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 20, 0.03)


def corners(gray: Bytes, count: int, taken: Float32 | None = None) -> Float32:
    """Up to `count` Shi-Tomasi corners spread over the image, (M, 2) px, strongest first.

    taken: (Q, 2) px to stay away from.
    """
    spread = max(5.0, 0.5 * float(np.sqrt(gray.size / max(count, 1))))
    mask = None
    if taken is not None:
        mask = np.full(gray.shape, 255, np.uint8)
        for u, v in taken:
            cv2.circle(mask, (round(float(u)), round(float(v))), round(spread), 0, -1)
    found = cv2.goodFeaturesToTrack(gray, count, 0.005, spread, mask=mask)
    if found is None:
        return np.zeros((0, 2), np.float32)
    return np.asarray(found, np.float32).reshape(-1, 2)


def follow(
    previous: Bytes, current: Bytes, uv: Float32, guess: Float32 | None = None
) -> tuple[Float32, NDArray[np.bool_]]:
    """Where points (M, 2) px of `previous` are in `current`: (M, 2) px and which to believe (M,).

    previous, current: (H, W) uint8 gray.
    guess: (M, 2) px to start from, e.g. the projection of a predicted pose. A point is believed
    when tracking it back returns within BACKWARD_PX of its start and it lies inside the image.
    """
    if len(uv) == 0:
        return np.zeros((0, 2), np.float32), np.zeros(0, bool)
    start = np.ascontiguousarray(uv, np.float32)
    flags = 0 if guess is None else cv2.OPTFLOW_USE_INITIAL_FLOW
    from_where = start.copy() if guess is None else np.ascontiguousarray(guess, np.float32)
    ahead, found, _ = cv2.calcOpticalFlowPyrLK(
        previous,
        current,
        start,
        from_where,
        winSize=WINDOW,
        maxLevel=LEVELS,
        criteria=CRITERIA,
        flags=flags,
    )
    back, returned, _ = cv2.calcOpticalFlowPyrLK(
        current,
        previous,
        ahead,
        start.copy(),
        winSize=WINDOW,
        maxLevel=LEVELS,
        criteria=CRITERIA,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    height, width = current.shape
    good = (found[:, 0] > 0) & (returned[:, 0] > 0)
    good &= np.linalg.norm(back - start, axis=1) < BACKWARD_PX
    good &= (ahead >= 0).all(1) & (ahead[:, 0] <= width - 1) & (ahead[:, 1] <= height - 1)
    return np.asarray(ahead, np.float32), np.asarray(good, bool)
