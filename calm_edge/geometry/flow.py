"""Corners and where they went: Shi-Tomasi and pyramidal Lucas-Kanade with a backward check."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

Gray = NDArray[np.uint8]
Float32 = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class LucasKanade:
    """How to follow. backward_px: how near its start a point must return, over backward_levels.

    margin_px: what of the image's border is not believed.
    """

    window_px: int = 17
    levels: int = 3
    iterations: int = 20
    step_px: float = 0.03
    backward_levels: int = 1
    backward_px: float = 0.7
    margin_px: float = 0.0


TRACKING = LucasKanade()


def away_from(shape: tuple[int, int], taken: Float32, radius_px: float) -> Gray:
    """A mask (H, W) that is 0 within radius_px of the points taken (Q, 2), else 255."""
    mask = np.full(shape, 255, np.uint8)
    for u, v in taken:
        cv2.circle(mask, (round(float(u)), round(float(v))), round(radius_px), 0, -1)
    return mask


def corners(gray: Gray, count: int, taken: Float32 | None = None) -> Float32:
    """Up to `count` Shi-Tomasi corners spread over the image, (M, 2) px, strongest first.

    taken: (Q, 2) px to stay away from.
    """
    spread = max(5.0, 0.5 * float(np.sqrt(gray.size / max(count, 1))))
    height, width = gray.shape
    mask = None if taken is None else away_from((height, width), taken, spread)
    found = cv2.goodFeaturesToTrack(gray, count, 0.005, spread, mask=mask)
    if found is None:
        return np.zeros((0, 2), np.float32)
    return np.asarray(found, np.float32).reshape(-1, 2)


def follow(
    source: Gray,
    target: Gray,
    uv: Float32,
    guess: Float32 | None = None,
    how: LucasKanade = TRACKING,
) -> tuple[Float32, NDArray[np.bool_]]:
    """Where points (M, 2) px of `source` are in `target`: (M, 2) px and which to believe (M,).

    guess: (M, 2) px to start from, e.g. the projection of a predicted pose. A point is believed
    when tracking it back returns to its start and it lies inside the image.
    """
    if len(uv) == 0:
        return np.zeros((0, 2), np.float32), np.zeros(0, bool)
    start = np.ascontiguousarray(uv, np.float32)
    ahead, found = follow_ahead(source, target, start, start if guess is None else guess, how)
    there_and_back = replace(how, levels=how.backward_levels)
    back, returned = follow_ahead(target, source, ahead, start, there_and_back)
    height, width = target.shape
    last = np.array([width, height], np.float32) - 1 - how.margin_px
    good = found & returned & (np.linalg.norm(back - start, axis=1) < how.backward_px)
    good &= (ahead >= how.margin_px).all(1) & (ahead <= last).all(1)
    return ahead, np.asarray(good, bool)


def follow_ahead(
    source: Gray, target: Gray, uv: Float32, guess: Float32, how: LucasKanade
) -> tuple[Float32, NDArray[np.bool_]]:
    """Points (M, 2) px, M > 0, from a guess (M, 2) px, and which were found (M,): no way back."""
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, how.iterations, how.step_px)
    # a copy: OpenCV writes into its guess
    begin = np.array(guess, np.float32, order="C")
    ahead, found, _ = cv2.calcOpticalFlowPyrLK(
        source, target, np.ascontiguousarray(uv, np.float32), begin,
        winSize=(how.window_px, how.window_px), maxLevel=how.levels,
        criteria=criteria, flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )  # fmt: skip
    return np.asarray(ahead, np.float32), found[:, 0] > 0


def neighbouring_flow(uv: Float32, flow: Float32, known: NDArray[np.bool_]) -> Float32:
    """Flow (N, 2) at uv (N, 2) px, unknown entries being the median of the nearest known ones."""
    if not known.any():
        return np.zeros_like(flow)
    if known.all():
        return flow
    distance = np.linalg.norm(uv[~known][:, None] - uv[known][None], axis=2)
    k = min(5, int(known.sum()))
    nearest = np.argpartition(distance, k - 1, axis=1)[:, :k]
    filled = flow.copy()
    filled[~known] = np.median(flow[known][nearest], axis=1)
    return filled
