"""Learned matches brought to a part of a pixel: what the tracks of bundle start from.

The features find a point wherever it went; Lucas-Kanade from there measures it. Where pictures are
turned or zoomed against each other, one is warped to look like the other, and read again.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from calm_edge.backbones.bundle.correspond import Bool, Found, find
from calm_edge.backbones.bundle.features import FeatureNet
from calm_edge.backbones.bundle.place import LearnedPlace
from calm_edge.backbones.bundle.tracks import (
    FOLLOWED_PX,
    MATCHING,
    detect_corners,
    on_epipolar_lines,
    sift_homography,
)
from calm_edge.geometry.flow import Gray, follow, neighbouring_flow
from calm_edge.types import Float, Float32

# What a measured match is off by: so much of the features' own sigma, and so many times as far as
# half the window puts it elsewhere. Fitted to true errors (models/calm-geo/README.md), but for the
# common factor: see `_as_a_whole`.
FEATURES_SHARE, WINDOWS_SHARE = 0.25, 2.6
SIGMA_RANGE_PX = (0.2, 3.0)
HALF_WINDOW = replace(MATCHING, window_px=MATCHING.window_px // 2 + 1, levels=1)
# Lucas-Kanade that leaves the features' place by more sigmas found something else.
MAX_SIGMAS = 3.0
# What neighbours alone led to, and what the features alone placed.
UNSUPPORTED_PX, MAX_SIGMA_PX = 1.0, 1.5
# Turned or zoomed by less, patches are alike as they are.
SAME_TURN_RAD, SAME_ZOOM = 0.07, 0.12
MIN_FOR_WARP, WARP_SHARE, MIN_ZOOM = 12, 0.3, 0.2
WARP_EPIPOLAR_PX = 3.0
WARP_INLIER = 0.03  # of the picture's width: parallax stays outside of the homography
# With fewer sure matches, other turns and zooms of the second picture are tried.
ENOUGH_SURE = 0.35
TURNS_DEG, ZOOMS = (-20.0, 0.0, 20.0), (0.5, 1.0, 2.0)


class LearnedMatching:
    """What `tracks.window_tracks` asks of a network."""

    def __init__(self, net: FeatureNet) -> None:
        self.net = net

    def along(self, source: Gray, target: Gray, uv: Float32) -> Found:
        """See tracks.Matching; raises BackboneError."""
        found = _found(self.net, source, target, uv)
        return _twice_seen(finished(source, target, uv, found))

    def homography(self, primary: Gray, assistant: Gray) -> Float | None:
        """See tracks.Matching; raises BackboneError.

        SIFT's few matches lie on far things more often than those of the road, which are many, and
        turn and zoom are what far things show.
        """
        rough = sift_homography(primary, assistant)
        if rough is not None:
            return rough
        uv = detect_corners(primary, np.zeros((0, 2), np.float32))
        return homography(uv, _any_way_up(self.net, primary, assistant, uv), primary.shape[1])

    def across(self, primary: Gray, assistant: Gray, H_a_p: Float, uv: Float32) -> Found:
        """See tracks.Matching; raises BackboneError."""
        return _twice_seen(self._across(primary, assistant, H_a_p, uv))

    def match(self, a: Gray, b: Gray, uv: Float32) -> Found:
        """Points uv (N, 2) px of any picture in any other; raises BackboneError.

        Their sigma says how they were found; `measured` are those to build on.
        """
        found = _any_way_up(self.net, a, b, uv)
        H_b_a = homography(uv, found, a.shape[1])
        return finished(a, b, uv, found) if H_b_a is None else self._across(a, b, H_b_a, uv)

    def _across(self, a: Gray, b: Gray, H_b_a: Float, uv: Float32) -> Found:
        if _alike(H_b_a, np.array(a.shape[::-1]) / 2):
            return finished(a, b, uv, _found(self.net, a, b, uv))
        seen = warped(b, H_b_a, a)
        return _through(finished(a, seen, uv, _found(self.net, a, seen, uv)), H_b_a, b)


def finished(a: Gray, b: Gray, uv: Float32, found: Found) -> Found:
    """Matches of uv (N, 2) px, measured on pictures that are alike.

    Two witnesses: where Lucas-Kanade and the features disagree, neither is believed. Where the
    features say nothing, Lucas-Kanade from what neighbours do may stand for itself, less sure; so
    may they, where there is nothing to measure.
    """
    near = MAX_SIGMAS * found.sigma_px
    moved, ok = follow(a, b, uv, found.uv, MATCHING)
    ok &= found.sure & (np.linalg.norm(moved - found.uv, axis=1) < near)
    rest = np.flatnonzero(~ok)
    start = uv + neighbouring_flow(uv, moved - uv, ok)
    again, returned = follow(a, b, uv[rest], start[rest], MATCHING)
    agree = np.linalg.norm(again - found.uv[rest], axis=1) < near[rest]
    moved[rest], ok[rest] = again, returned & agree
    led = np.zeros(len(uv), bool)
    led[rest] = returned & ~agree & ~found.sure[rest]
    alone = found.sure & ~ok & (found.sigma_px < MAX_SIGMA_PX)
    sigma = np.where(led, UNSUPPORTED_PX, found.sigma_px)
    sigma[ok] = _as_a_whole(_measured_sigma(a, b, uv[ok], moved[ok], found.sigma_px[ok]))
    uv_b = np.where((ok | led)[:, None], moved, found.uv)
    sure = ok | led | alone
    return Found(np.asarray(uv_b, np.float32), sure, np.asarray(sigma, np.float32), ok)


def _measured_sigma(a: Gray, b: Gray, uv: Float32, moved: Float32, features_px: Float32) -> Float32:
    """(N,) px, of points uv (N, 2) px of a that Lucas-Kanade has at `moved` (N, 2) in b.

    features_px: (N,) their sigma. A smaller window disagrees where a patch has two depths, or has
    changed.
    """
    half, _ = follow(a, b, uv, moved, HALF_WINDOW)
    apart = np.linalg.norm(half - moved, axis=1)
    sigma = np.hypot(FEATURES_SHARE * features_px, WINDOWS_SHARE * apart)
    return np.asarray(np.maximum(sigma, SIGMA_RANGE_PX[0]), np.float32)


def _as_a_whole(sigma: Float32) -> Float32:
    """Sigmas (N,) px of a pair of pictures, made to say as much as N corners that were followed.

    Else a pair whose eyes see differently would leave their distance to the other pairs.
    """
    if len(sigma) == 0:
        return sigma
    factor = FOLLOWED_PX * np.sqrt((1 / np.square(sigma)).mean())
    return np.asarray(np.clip(factor * sigma, *SIGMA_RANGE_PX), np.float32)


def _twice_seen(found: Found) -> Found:
    """Only what is measured: wrong matches cost a bundle more than missing ones."""
    return replace(found, sure=found.measured)


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


def _alike(H_b_a: Float, middle: NDArray[Any]) -> bool:
    """Patches around `middle` (2,) px of a look the same in b."""
    zoom, turn = _zoom_and_turn(H_b_a, middle)
    return abs(np.log(zoom)) < SAME_ZOOM and abs(turn) < SAME_TURN_RAD


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


def _found(net: FeatureNet, a: Gray, b: Gray, uv: Float32) -> Found:
    features_a, features_b = net.of([a, b])
    return find(net, features_a, features_b, uv)


def _any_way_up(net: FeatureNet, a: Gray, b: Gray, uv: Float32) -> Found:
    """Points of a in b; where few are found, the best of several turns and zooms of b."""
    best = _found(net, a, b, uv)
    if best.sure.sum() >= ENOUGH_SURE * len(uv):
        return best
    for turn, zoom in product(TURNS_DEG, ZOOMS):
        if (turn, zoom) != (0.0, 1.0):
            H_b_a = _turned(a, b, turn, zoom)
            there = _through(_found(net, a, warped(b, H_b_a, a), uv), H_b_a, b)
            best = max(best, there, key=lambda each: int(each.sure.sum()))
    return best


def _turned(a: Gray, b: Gray, turn_deg: float, zoom: float) -> Float:
    """H_b_a (3, 3) px: about the middles, b being zoomed and turned against a."""
    (ha, wa), (hb, wb) = a.shape, b.shape
    centred = np.array([[1, 0, -(wa - 1) / 2], [0, 1, -(ha - 1) / 2], [0, 0, 1]])
    c, s = zoom * np.cos(np.radians(turn_deg)), zoom * np.sin(np.radians(turn_deg))
    turned = np.array([[c, -s, (wb - 1) / 2], [s, c, (hb - 1) / 2], [0, 0, 1]])
    return np.asarray(turned @ centred)


def _through(found: Found, H_b_a: Float, b: Gray) -> Found:
    """What was found in b as warped, in b; what lies outside is none.

    Sigma stays as it was there: weighing the eyes less would leave their distance to the rest.
    """
    if len(found.uv) == 0:
        return found
    uv = cv2.perspectiveTransform(found.uv[None].astype(np.float64), H_b_a)[0]
    height, width = b.shape
    inside: Bool = (uv >= 0).all(1) & (uv <= np.array([width - 1, height - 1])).all(1)
    return Found(
        np.asarray(uv, np.float32), found.sure & inside, found.sigma_px, found.measured & inside
    )


def matcher(name: str = "calm-geo") -> LearnedMatching:
    """What a folder of `models/` matches with; raises BackboneError."""
    return LearnedMatching(FeatureNet.of_model(name))


def place(name: str = "calm-geo") -> LearnedPlace:
    """What a folder of `models/` knows places by; raises BackboneError."""
    return LearnedPlace(FeatureNet.of_model(name))
