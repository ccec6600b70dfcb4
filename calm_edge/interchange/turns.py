"""Turn of a camera from frame to frame, measured in its pictures without a calibration."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calm_edge.geometry.flow import LucasKanade, corners, follow
from calm_edge.types import Float

Gray = NDArray[np.uint8]

# width of the pictures that are measured: a turn of 0.1 px in it is 0.02 degrees
WIDTH_PX = 320
CORNERS = 160
LEAST_TRACKS = 12
# a longer interval between two frames is a gap
LONGEST_S = 0.5
TRACKING = LucasKanade(window_px=15, levels=4, iterations=12, margin_px=2.0)


@dataclass(frozen=True, slots=True)
class Turns:
    """Similarity between successive pictures of one camera.

    t_s: (N,) s. step: (N-1, 3) shift to the right and down [share of the width] and rotation
    clockwise [rad] of the picture's content. zoom: (N-1,) log of its magnification. sigma: (N-1,)
    of the shift, inf where there are too few tracks or a gap.
    """

    t_s: Float
    step: Float
    zoom: Float
    sigma: Float


class TurnMeter:
    """Measures the turns of one picture stream, with the memory of one small picture."""

    def __init__(self) -> None:
        self._before: Gray | None = None
        self._t_s: list[float] = []
        self._rows: list[tuple[float, float, float, float, float]] = []

    def add(self, t_s: float, picture: Gray) -> None:
        """Measure the turn since the last picture; picture: (H, W) or (H, W, 3), any size."""
        small = reduced(picture)
        if self._before is not None:
            known = t_s - self._t_s[-1] <= LONGEST_S and small.shape == self._before.shape
            self._rows.append(similarity(self._before, small) if known else _UNKNOWN)
        self._t_s.append(t_s)
        self._before = small

    def turns(self) -> Turns:
        """Return the turns of all pictures so far."""
        table = np.array(self._rows, np.float64).reshape(-1, 5)
        return Turns(np.array(self._t_s), table[:, :3], table[:, 3], table[:, 4])


_UNKNOWN = (0.0, 0.0, 0.0, 0.0, float("inf"))


def reduced(picture: Gray) -> Gray:
    """Scale a picture (H, W) or (H, W, 3) to WIDTH_PX, grey."""
    height, width = picture.shape[:2]
    if width > WIDTH_PX:
        size = WIDTH_PX, max(1, round(height * WIDTH_PX / width))
        picture = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)
    if picture.ndim == 3:
        picture = np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), np.uint8)
    return picture


def similarity(before: Gray, after: Gray) -> tuple[float, float, float, float, float]:
    """Fit shift right, shift down, rotation, log zoom, and the sigma of the shift.

    Robust to the parallax of near points: least squares with Cauchy weights on tracked corners.
    """
    uv = corners(before, CORNERS)
    to, good = follow(before, after, uv, how=TRACKING)
    if good.sum() < LEAST_TRACKS:
        return _UNKNOWN
    height, width = before.shape
    x, y = ((uv[good] - np.array([width, height], np.float32) / 2) / width).astype(np.float64).T
    flow = ((to[good] - uv[good]) / width).astype(np.float64).T.ravel()
    n = len(x)
    one, none = np.ones(n), np.zeros(n)
    columns = np.stack(
        [np.r_[one, none], np.r_[none, one], np.r_[-y, x], np.r_[x, y]],
        axis=1,
    )
    # the median shift to begin with: most of a picture is far
    found = np.array([np.median(flow[:n]), np.median(flow[n:]), 0.0, 0.0])
    scale = 0.0
    for _ in range(6):
        left = (flow - columns @ found).reshape(2, n)
        distance = np.hypot(*left)
        scale = 1.2 * float(np.median(distance)) + 0.02 / width
        weight = np.tile(1 / (1 + (distance / (2 * scale)) ** 2), 2)
        weighted = columns * weight[:, None]
        found = np.linalg.lstsq(weighted.T @ columns, weighted.T @ flow, rcond=None)[0]
    right, down, roll, zoom = found.tolist()
    return right, down, roll, zoom, scale / np.sqrt(n)
