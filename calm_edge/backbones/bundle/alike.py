"""Pictures turned or zoomed against each other: what makes one look like the other."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from calm_edge.backbones.bundle.matching import Bool, Found
from calm_edge.backbones.bundle.tracks import on_epipolar_lines
from calm_edge.geometry.flow import Gray
from calm_edge.types import Float, Float32

# Turned or zoomed by less, patches are alike as they are.
SAME_TURN_RAD, SAME_ZOOM = 0.07, 0.12
MIN_FOR_WARP, WARP_SHARE, MIN_ZOOM = 12, 0.3, 0.2
WARP_EPIPOLAR_PX = 3.0
WARP_INLIER = 0.03  # of the picture's width: parallax stays outside of the homography


def homography(uv: Float32, found: Found, width: int) -> Float | None:
    """H_b_a (3, 3) px through the sure ones of N matches, parallax left out; None where too few."""
    sure = found.sure.copy()
    sure[sure] = on_epipolar_lines(uv[sure], found.uv[sure], WARP_EPIPOLAR_PX)
    if sure.sum() < MIN_FOR_WARP:
        return None
    H, fits = cv2.findHomography(uv[sure], found.uv[sure], cv2.RANSAC, WARP_INLIER * width)
    if H is None or fits.sum() < max(MIN_FOR_WARP, WARP_SHARE * sure.sum()):
        return None
    if not MIN_ZOOM < _zoom_and_turn(H, uv[sure].mean(0))[0] < 1 / MIN_ZOOM:
        return None
    return np.asarray(H, np.float64)


def are_alike(H_b_a: Float, a: Gray) -> bool:
    """Patches in the middle of a look the same in b."""
    zoom, turn = _zoom_and_turn(H_b_a, _middle(a))
    return abs(np.log(zoom)) < SAME_ZOOM and abs(turn) < SAME_TURN_RAD


def zoom_of(H_b_a: Float, a: Gray) -> float:
    """How much larger b shows the middle of a."""
    return _zoom_and_turn(H_b_a, _middle(a))[0]


def _middle(picture: Gray) -> Float:
    """(2,) px."""
    return np.array(picture.shape[::-1]) / 2


def _zoom_and_turn(H: NDArray[Any], at: NDArray[Any]) -> tuple[float, float]:
    """What H (3, 3) px does around a pixel (2,): its zoom, and its turn in radians."""
    x, y, w = H @ np.array([*at, 1.0])
    local = (H[:2, :2] - np.outer([x / w, y / w], H[2, :2])) / w
    turn = np.arctan2(local[1, 0] - local[0, 1], local[0, 0] + local[1, 1])
    return float(np.sqrt(max(np.linalg.det(local), 1e-12))), float(turn)


def warped(b: Gray, H_b_a: Float, a: Gray) -> Gray:
    """b as a would show it, smoothed where that shrinks it: what aliases has moved."""
    zoom = float(np.sqrt(abs(np.linalg.det(H_b_a[:2, :2]))))
    if zoom > 1 + SAME_ZOOM:
        b = np.asarray(cv2.GaussianBlur(b, (0, 0), 0.5 * np.sqrt(zoom**2 - 1)), np.uint8)
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpPerspective(b, H_b_a, a.shape[::-1], flags=flags), np.uint8)


def turned(a: Gray, b: Gray, turn_deg: float, zoom: float) -> Float:
    """H_b_a (3, 3) px: about the middles, b being zoomed and turned against a."""
    (ha, wa), (hb, wb) = a.shape, b.shape
    centred = np.array([[1, 0, -(wa - 1) / 2], [0, 1, -(ha - 1) / 2], [0, 0, 1]])
    c, s = zoom * np.cos(np.radians(turn_deg)), zoom * np.sin(np.radians(turn_deg))
    turned = np.array([[c, -s, (wb - 1) / 2], [s, c, (hb - 1) / 2], [0, 0, 1]])
    return np.asarray(turned @ centred)


def seen_at(H_b_a: Float, uv: Float32, b: Gray) -> tuple[Float32, Bool]:
    """Points uv (N, 2) px of a in b (N, 2) px, and whether b shows them (N,)."""
    if len(uv) == 0:
        return uv, np.zeros(0, bool)
    there = cv2.perspectiveTransform(uv[None].astype(np.float64), H_b_a)[0]
    height, width = b.shape
    inside: Bool = (there >= 0).all(1) & (there <= np.array([width - 1, height - 1])).all(1)
    return np.asarray(there, np.float32), inside


def agreeing(uv: Float32, found: Found, width: int) -> int:
    """How many sure matches one turn, zoom and shift explains, but for parallax.

    What is only sure may be wrong all over: in a picture that shows something else, half of all
    cells find their way back.
    """
    if found.sure.sum() < MIN_FOR_WARP:
        return 0
    _, fits = cv2.estimateAffinePartial2D(
        uv[found.sure],
        found.uv[found.sure],
        method=cv2.RANSAC,
        ransacReprojThreshold=WARP_INLIER * width,
    )
    return 0 if fits is None else int(fits.sum())
