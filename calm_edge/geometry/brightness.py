"""Gain and offset of the brightness between two pictures, so that they can be matched.

Lucas-Kanade compares grey values: a gain of 1.05 between the pictures moves its tracks by 0.1 px,
one of 0.6 loses them all. Exposure changes over time, and differs between two cameras.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Gray = NDArray[np.uint8]
Float32 = NDArray[np.float32]

# Points from which gain and offset are taken, at least and at most.
MIN_POINTS, MOST_POINTS = 20, 100
# Patches around them: wider than the window of tracking, which pulls a track to where the grey
# values are equal. And the range of grey values that are neither black nor saturated.
RADIUS_PX = 12.0
UNSATURATED = (1.0, 250.0)
# Smoothing before that: a picture blurred by motion has less contrast, and not another gain.
SMOOTH_PX = 6
# A change matters from this gain on, and from this difference [grey levels] of a mean grey value.
GAIN_TOLERANCE, LEVEL_TOLERANCE = 0.015, 2.0
# As above, for gain and offset taken from histograms: the pictures do not show the same.
ROUGH_FACTOR = 4.0
# Quantiles of the histograms that are compared.
_QUANTILES = np.linspace(0.1, 0.9, 17)
# Residuals [grey levels] beyond which a point counts less, and rounds of reweighting.
_HUBER_LEVELS, _ROUNDS = 3.0, 6
# Grey values with less spread than this determine no gain.
_LEAST_SPREAD = 1.5
_GAINS = (0.05, 20.0)
_AXIS = np.linspace(-RADIUS_PX, RADIUS_PX, 5, dtype=np.float32)
_PATCH = np.stack(np.meshgrid(_AXIS, _AXIS), -1).reshape(-1, 2)


@dataclass(frozen=True, slots=True)
class Brightness:
    """target = gain * source + offset, in grey levels; `middle`: mean of the source's."""

    gain: float = 1.0
    offset: float = 0.0
    middle: float = 128.0

    def differs(self, other: Brightness, rough: bool = False) -> bool:
        """Whether matches change if this is used in place of `other`. rough: as of histograms."""
        factor = ROUGH_FACTOR if rough else 1.0
        ratio = abs(self.gain / other.gain - 1.0)
        shift = abs((self.gain - other.gain) * self.middle + self.offset - other.offset)
        return bool(ratio > factor * GAIN_TOLERANCE or shift > factor * LEVEL_TOLERANCE)


def at_points(source: Gray, target: Gray, uv: Float32, moved: Float32) -> Brightness | None:
    """Change between patches at uv (N, 2) px of the source and at `moved` (N, 2) of the target.

    A line through their grey values, robust against wrong matches. None with fewer than MIN_POINTS
    points, or if half of the pixels are black or saturated.
    """
    if len(uv) < MIN_POINTS:
        return None
    chosen = np.unique(np.linspace(0, len(uv) - 1, MOST_POINTS).round().astype(np.int64))
    x, y = _around(source, uv[chosen]), _around(target, moved[chosen])
    low, high = UNSATURATED
    good = (x > low) & (x < high) & (y > low) & (y < high)
    return _line(x[good], y[good]) if good.mean() > 0.5 else None


def of_histograms(source: Gray, target: Gray) -> Brightness | None:
    """Rough change between pictures of about the same scene; None without contrast.

    Black and saturated pixels do not count: what a warp leaves empty is black.
    """
    x, y = (_quantiles(picture) for picture in (source, target))
    return None if x is None or y is None else _line(x, y)


def evened(source: Gray, target: Gray) -> tuple[Gray, Gray]:
    """Both pictures made `alike` by their histograms."""
    change = of_histograms(source, target)
    if change is None or not change.differs(Brightness(), rough=True):
        return source, target
    return alike(source, target, change)


def alike(source: Gray, target: Gray, change: Brightness) -> tuple[Gray, Gray]:
    """Both pictures as bright as the one with more contrast; as they are without a change."""
    if not change.differs(Brightness()):
        return source, target
    levels = np.arange(256)
    if change.gain < 1:
        table = (levels - change.offset) / change.gain
        return source, _through(target, table)
    return _through(source, change.gain * levels + change.offset), target


def _through(picture: Gray, table: NDArray[np.floating]) -> Gray:
    return np.asarray(cv2.LUT(picture, np.clip(np.rint(table), 0, 255).astype(np.uint8)), np.uint8)


def _around(picture: Gray, uv: Float32) -> NDArray[np.float64]:
    """Smoothed grey values (N, P) of patches around uv (N, 2) px."""
    height, width = picture.shape
    size = max(1, width // SMOOTH_PX), max(1, height // SMOOTH_PX)
    picture = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)
    scale = np.array(size, np.float32) / np.array([width, height], np.float32)
    at = (np.nan_to_num(uv)[:, None, :] + _PATCH + 0.5) * scale - 0.5
    x, y = (np.ascontiguousarray(at[..., k], np.float32) for k in (0, 1))
    values = cv2.remap(picture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(values, np.float64)


def _quantiles(picture: Gray) -> NDArray[np.float64] | None:
    counts = np.bincount(picture.ravel(), minlength=256)[1:255]
    total = counts.sum()
    if total < 0.1 * picture.size:
        return None
    share = (np.cumsum(counts) - 0.5 * counts) / total
    return np.asarray(np.interp(_QUANTILES, share, np.arange(1, 255)))


def _line(x: NDArray[np.float64], y: NDArray[np.float64]) -> Brightness | None:
    """Robust line y = gain * x + offset through points that are inexact in both coordinates.

    The gain is the ratio of the standard deviations (reduced major axis), iteratively reweighted.
    """
    middle, weight = float(np.median(x)), np.ones(len(x))
    if x.std() < _LEAST_SPREAD:
        return Brightness(1.0, float(np.median(y - x)), middle)
    for _ in range(_ROUNDS):
        mean_x, mean_y = np.average(x, weights=weight), np.average(y, weights=weight)
        spread_x = float(np.average((x - mean_x) ** 2, weights=weight))
        spread_y = float(np.average((y - mean_y) ** 2, weights=weight))
        if spread_x <= 0:
            return None
        gain = float(np.sqrt(spread_y / spread_x))
        offset = float(mean_y - gain * mean_x)
        if not _GAINS[0] < gain < _GAINS[1]:
            return None
        residual = np.abs(y - gain * x - offset) / np.hypot(1.0, gain)
        scale = max(_HUBER_LEVELS * gain / np.hypot(1.0, gain), float(np.median(residual)))
        weight = np.minimum(1.0, scale / np.maximum(residual, 1e-9)) ** 2
    return Brightness(gain, offset, middle)
