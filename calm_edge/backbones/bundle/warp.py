"""Homographies between pictures that are rotated or zoomed against each other."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from calm_edge.backbones.bundle.matching import Bool, Matches
from calm_edge.backbones.bundle.tracks import on_epipolar_lines
from calm_edge.geometry.flow import Gray
from calm_edge.types import Float, Float32

# Patches match without a warp below this rotation and log zoom.
SAME_TURN_RAD, SAME_ZOOM = 0.07, 0.12
MIN_FOR_WARP, WARP_SHARE, MIN_ZOOM = 12, 0.3, 0.2
WARP_EPIPOLAR_PX = 3.0
WARP_INLIER = 0.03  # inlier threshold, share of the picture's long side; includes parallax


def homography(uv: Float32, found: Matches, side: int) -> Float | None:
    """H_b_a (3, 3) px from the sure ones of N matches by RANSAC; None with too few inliers.

    uv: (N, 2) px of a. found: matches in b. side: long one of b [px], for the inlier threshold.
    """
    sure = found.sure.copy()
    sure[sure] = on_epipolar_lines(uv[sure], found.uv[sure], WARP_EPIPOLAR_PX)
    if sure.sum() < MIN_FOR_WARP:
        return None
    H, fits = cv2.findHomography(uv[sure], found.uv[sure], cv2.RANSAC, WARP_INLIER * side)
    if H is None or fits.sum() < max(MIN_FOR_WARP, WARP_SHARE * sure.sum()):
        return None
    if not MIN_ZOOM < _zoom_and_turn(H, uv[sure].mean(0))[0] < 1 / MIN_ZOOM:
        return None
    return np.asarray(H, np.float64)


def are_alike(H_b_a: Float, a: Gray) -> bool:
    """Whether b shows the middle of a at nearly the same zoom and rotation, so needs no warp."""
    zoom, turn = _zoom_and_turn(H_b_a, _middle(a))
    return abs(np.log(zoom)) < SAME_ZOOM and abs(turn) < SAME_TURN_RAD


def zoom_of(H_b_a: Float, a: Gray) -> float:
    """Magnification from a to b in the middle of a: above 1 if b shows the scene larger."""
    return _zoom_and_turn(H_b_a, _middle(a))[0]


def _middle(picture: Gray) -> Float:
    """Centre (2,) px of a picture."""
    return np.array(picture.shape[::-1]) / 2


def _zoom_and_turn(H: NDArray[Any], at: NDArray[Any]) -> tuple[float, float]:
    """Zoom and rotation [rad] of H (3, 3) px to first order at a pixel (2,)."""
    x, y, w = H @ np.array([*at, 1.0])
    local = (H[:2, :2] - np.outer([x / w, y / w], H[2, :2])) / w
    turn = np.arctan2(local[1, 0] - local[0, 1], local[0, 0] + local[1, 1])
    return float(np.sqrt(max(np.linalg.det(local), 1e-12))), float(turn)


def warped(b: Gray, H_b_a: Float, a: Gray) -> Gray:
    """Warp b to look like a, low-pass filtered before it is shrunk, against aliasing."""
    zoom = float(np.sqrt(abs(np.linalg.det(H_b_a[:2, :2]))))
    if zoom > 1 + SAME_ZOOM:
        b = np.asarray(cv2.GaussianBlur(b, (0, 0), 0.5 * np.sqrt(zoom**2 - 1)), np.uint8)
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpPerspective(b, H_b_a, a.shape[::-1], flags=flags), np.uint8)


def turned(a: Gray, b: Gray, turn_deg: float, zoom: float) -> Float:
    """H_b_a (3, 3) px that takes the middle of a to that of b, with a rotation and a zoom."""
    (ha, wa), (hb, wb) = a.shape, b.shape
    centred = np.array([[1, 0, -(wa - 1) / 2], [0, 1, -(ha - 1) / 2], [0, 0, 1]])
    c, s = zoom * np.cos(np.radians(turn_deg)), zoom * np.sin(np.radians(turn_deg))
    turned = np.array([[c, -s, (wb - 1) / 2], [s, c, (hb - 1) / 2], [0, 0, 1]])
    return np.asarray(turned @ centred)


def seen_at(H_b_a: Float, uv: Float32, b: Gray) -> tuple[Float32, Bool]:
    """Points uv (N, 2) px of a mapped to b (N, 2) px, and whether they lie in it (N,)."""
    if len(uv) == 0:
        return uv, np.zeros(0, bool)
    there = cv2.perspectiveTransform(uv[None].astype(np.float64), H_b_a)[0]
    height, width = b.shape
    inside: Bool = (there >= 0).all(1) & (there <= np.array([width - 1, height - 1])).all(1)
    return np.asarray(there, np.float32), inside


def agreeing(uv: Float32, found: Matches, side: int) -> int:
    """Number of sure matches that are inliers of one similarity (RANSAC).

    Mutual matches alone prove nothing: pictures of different scenes have them in half of all cells.
    """
    if found.sure.sum() < MIN_FOR_WARP:
        return 0
    _, fits = cv2.estimateAffinePartial2D(
        uv[found.sure],
        found.uv[found.sure],
        method=cv2.RANSAC,
        ransacReprojThreshold=WARP_INLIER * side,
    )
    return 0 if fits is None else int(fits.sum())
