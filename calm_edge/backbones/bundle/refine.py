"""Refinement of matches to sub-pixel accuracy by Lucas-Kanade, with a sigma of each."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calm_edge.backbones.bundle.edges import across, edges
from calm_edge.backbones.bundle.matching import FOLLOWED_PX, Matches
from calm_edge.backbones.bundle.tracks import MATCHING
from calm_edge.geometry import brightness
from calm_edge.geometry.flow import Gray, LucasKanade, follow, follow_ahead, neighbouring_flow
from calm_edge.types import Float32

# Sigma of a refined match, the root of the sum of squares of two terms: a share of the features'
# sigma, and a multiple of how far the match moves with a Lucas-Kanade window of half the size.
# Fitted to true errors (models/calm-geo/README.md) up to a common factor: see `_normalised`.
FEATURES_SHARE, WINDOWS_SHARE = 0.25, 2.6
SIGMA_RANGE_PX = (0.2, 3.0)
# Lucas-Kanade from the features' matches, which are off by a few pixels at most: higher pyramid
# levels only lose points.
FROM_FEATURES = replace(MATCHING, levels=1)
# Largest distance of the refined match from the features' one, in its sigmas.
MAX_SIGMAS = 3.0
# Sigma [px] of a Lucas-Kanade match that the features do not support; largest sigma [px] of a match
# of the features that is kept without Lucas-Kanade.
UNSUPPORTED_PX, MAX_SIGMA_PX = 1.0, 1.5


def refined(
    a: Gray, b: Gray, uv: Float32, found: Matches, how: LucasKanade = FROM_FEATURES
) -> Matches:
    """Refine matches of uv (N, 2) px by Lucas-Kanade, on images of similar zoom and rotation.

    Matches are dropped where Lucas-Kanade and the features disagree. Where the features have no
    match, a track of Lucas-Kanade that started from the flow of neighbouring points is kept, with a
    sigma of UNSUPPORTED_PX; where Lucas-Kanade has none, the features' match with its own sigma.
    """
    sure = found.sure
    change = brightness.at_points(a, b, uv[sure], found.uv[sure])
    if change is None:
        change = brightness.of_histograms(a, b)
    if change is not None:
        a, b = brightness.alike(a, b, change)
    near = MAX_SIGMAS * found.sigma_px
    moved, ok = follow(a, b, uv, found.uv, how)
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
    sigma[ok] = _normalised(_measured_sigma(a, b, uv[ok], moved[ok], found.sigma_px[ok], how))
    uv_b = np.where((ok | led)[:, None], moved, found.uv)
    sure = ok | led | alone
    return Matches(np.asarray(uv_b, np.float32), sure, np.asarray(sigma, np.float32), ok)


def _measured_sigma(
    a: Gray, b: Gray, uv: Float32, moved: Float32, features_px: Float32, how: LucasKanade
) -> Float32:
    """Sigma (N,) px of points uv (N, 2) px of a that Lucas-Kanade found at `moved` (N, 2) in b.

    features_px: (N,) sigma of the features. Where a patch spans two depths or has changed, a
    smaller window gives another position: the difference adds to the sigma, but for what is along
    an edge.
    """
    if len(uv) == 0:
        return features_px
    half_window = replace(how, window_px=how.window_px // 2 + 1, levels=1)
    half, _ = follow_ahead(a, b, uv, moved, half_window)
    apart = np.linalg.norm(across(edges(b, moved), half - moved), axis=1)
    sigma = np.hypot(FEATURES_SHARE * features_px, WINDOWS_SHARE * apart)
    return np.asarray(np.maximum(sigma, SIGMA_RANGE_PX[0]), np.float32)


def _normalised(sigma: Float32) -> Float32:
    """Scale the sigmas (N,) px of the matches of two pictures to a fixed mean information.

    That of corners tracked by Lucas-Kanade, 1 / FOLLOWED_PX^2.

    Else pairs of pictures that look different would hardly constrain the rig.
    """
    if len(sigma) == 0:
        return sigma
    factor = FOLLOWED_PX * np.sqrt((1 / np.square(sigma)).mean())
    return np.asarray(np.clip(factor * sigma, *SIGMA_RANGE_PX), np.float32)
