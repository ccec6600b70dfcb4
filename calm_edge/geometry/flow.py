"""Shi-Tomasi corners, and pyramidal Lucas-Kanade tracking with a forward-backward check."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from calm_edge.geometry import brightness
from calm_edge.geometry.brightness import Brightness

Gray = NDArray[np.uint8]
Float32 = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class LucasKanade:
    """Parameters of Lucas-Kanade tracking (see cv2.calcOpticalFlowPyrLK).

    levels: pyramid levels. step_px: convergence threshold. backward_px: a point tracked back over
    backward_levels must end within this distance of its start. margin_px: points this close to
    the image border are rejected.
    """

    window_px: int = 17
    levels: int = 3
    iterations: int = 20
    step_px: float = 0.03
    backward_levels: int = 1
    backward_px: float = 0.7
    margin_px: float = 0.0


TRACKING = LucasKanade()
# With a smaller share of tracked points these do not show the change of brightness.
_ENOUGH_TRACKED = 0.3
# how often points are tracked again with the brightness of the images adapted
_MOST_AGAIN = 3


def long_side(image: NDArray[np.generic]) -> int:
    """Width or height [px] of an image (H, W) or (H, W, 3), whichever is larger.

    Thresholds in px scale with it: an image on its side has the same focal length.
    """
    height, width = image.shape[:2]
    return max(int(height), int(width))


def away_from(shape: tuple[int, int], taken: Float32, radius_px: float) -> Gray:
    """Mask (H, W), 0 within radius_px of the points `taken` (Q, 2) px, else 255."""
    mask = np.full(shape, 255, np.uint8)
    for u, v in taken:
        cv2.circle(mask, (round(float(u)), round(float(v))), round(radius_px), 0, -1)
    return mask


def corners(
    gray: Gray, count: int, taken: Float32 | None = None, used: Gray | None = None
) -> Float32:
    """Detect up to `count` Shi-Tomasi corners (M, 2) px, spread over the image, strongest first.

    taken: (Q, 2) px points to keep a distance from. used: (H, W), 0 in parts left out. See
    cv2.goodFeaturesToTrack.
    """
    spread = max(5.0, 0.5 * float(np.sqrt(gray.size / max(count, 1))))
    height, width = gray.shape
    mask = None if taken is None else away_from((height, width), taken, spread)
    if used is not None:
        mask = used if mask is None else mask & used
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
    """Track points (M, 2) px from `source` to `target`: positions (M, 2) px and valid mask (M,).

    guess: (M, 2) px initial positions. A point is valid if it lies inside the image and tracking
    it back returns to its start (Kalal et al., "Forward-backward error", 2010). Gain and offset of
    the brightness between the images make no difference.
    """
    if len(uv) == 0:
        return np.zeros((0, 2), np.float32), np.zeros(0, bool)
    ahead, good = _there_and_back(source, target, uv, guess, how)
    used = Brightness()
    for _ in range(_MOST_AGAIN):
        change, rough = _change(source, target, uv, ahead, good)
        if change is None or not change.differs(used, rough):
            break
        used = change
        images = brightness.alike(source, target, change)
        ahead, good = _there_and_back(*images, uv, guess, how)
    return ahead, good


def _change(
    source: Gray, target: Gray, uv: Float32, moved: Float32, good: NDArray[np.bool_]
) -> tuple[Brightness | None, bool]:
    """Change of the brightness by tracked points, with few of them by histograms (True)."""
    if good.sum() >= max(brightness.MIN_POINTS, _ENOUGH_TRACKED * len(uv)):
        return brightness.at_points(source, target, uv[good], moved[good]), False
    return brightness.of_histograms(source, target), True


def _there_and_back(
    source: Gray, target: Gray, uv: Float32, guess: Float32 | None, how: LucasKanade
) -> tuple[Float32, NDArray[np.bool_]]:
    """Track forward and backward, on images of equal brightness, see `follow`."""
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
    """Track points (M, 2) px, M > 0, without the backward check: positions and found mask (M,).

    guess: (M, 2) px initial positions.
    """
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, how.iterations, how.step_px)
    # a copy, because OpenCV overwrites the initial positions
    begin = np.array(guess, np.float32, order="C")
    ahead, found, _ = cv2.calcOpticalFlowPyrLK(
        source, target, np.ascontiguousarray(uv, np.float32), begin,
        winSize=(how.window_px, how.window_px), maxLevel=how.levels,
        criteria=criteria, flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )  # fmt: skip
    return np.asarray(ahead, np.float32), found[:, 0] > 0


def neighbouring_flow(uv: Float32, flow: Float32, known: NDArray[np.bool_]) -> Float32:
    """Fill unknown entries of the flow (N, 2) at uv (N, 2) px by the median of known neighbours."""
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
