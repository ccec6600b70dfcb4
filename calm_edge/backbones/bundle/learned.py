"""Learned matches brought to a part of a pixel: what the tracks of bundle start from.

The features find a point wherever it went; Lucas-Kanade from there measures it. Where pictures are
turned or zoomed against each other, one is warped to look like the other, and read again.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product, zip_longest

import numpy as np

from calm_edge.backbones.bundle.alike import (
    agreeing,
    are_alike,
    homography,
    seen_at,
    turned,
    warped,
    zoom_of,
)
from calm_edge.backbones.bundle.correspond import find
from calm_edge.backbones.bundle.features import FeatureNet
from calm_edge.backbones.bundle.matching import FOLLOWED_PX, Bool, Found
from calm_edge.backbones.bundle.place import LearnedPlace
from calm_edge.backbones.bundle.tracks import (
    MATCHING,
    detect_corners,
    sift_homography,
)
from calm_edge.geometry.flow import Gray, follow, follow_ahead, neighbouring_flow
from calm_edge.types import Float, Float32

# What a measured match is off by: so much of the features' own sigma, and so many times as far as
# half the window puts it elsewhere. Fitted to true errors (models/calm-geo/README.md), but for the
# common factor: see `_as_a_whole`.
FEATURES_SHARE, WINDOWS_SHARE = 0.25, 2.6
SIGMA_RANGE_PX = (0.2, 3.0)
# Features are within a few pixels: from farther up the pyramid, points only get lost.
FROM_FEATURES = replace(MATCHING, levels=1)
HALF_WINDOW = replace(MATCHING, window_px=MATCHING.window_px // 2 + 1, levels=1)
# Lucas-Kanade that leaves the features' place by more sigmas found something else.
MAX_SIGMAS = 3.0
# What neighbours alone led to, and what the features alone placed.
UNSUPPORTED_PX, MAX_SIGMA_PX = 1.0, 1.5
# What is shown so much larger is looked at as it is: shrunk, it would lose too much. By less,
# making the other one larger costs more: what is blurred is measured worse.
MUCH_LARGER = 1.5
# Where fewer matches agree on a turn and a zoom, others of the second picture are tried.
ENOUGH_AGREE = 0.5
TURNS_DEG, ZOOMS = (-20.0, 0.0, 20.0), (0.5, 1.0, 2.0)


class LearnedMatching:
    """What `tracks.window_tracks` asks of a network."""

    def __init__(self, net: FeatureNet) -> None:
        self.net = net
        # of the window at hand: assistant's pictures, and as they are looked at under which H_a_p
        self._expected: list[tuple[Gray, Float, Gray]] = []

    def expect(self, primary: list[Gray], assistant: list[Gray], H_a_p: Float | None) -> None:
        """See tracks.Matching."""
        self._expected = []
        if H_a_p is not None:
            a = primary[0]
            self._expected = [(b, H_a_p, _made_alike(a, b, H_a_p)) for b in assistant]
        # in the order they will be matched in
        for pair in zip_longest(primary, (alike for _, _, alike in self._expected)):
            self.net.begin([picture for picture in pair if picture is not None])

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
        found = _found(self.net, primary, assistant, uv)
        found = _any_way_up(self.net, primary, assistant, uv, found)
        return homography(uv, found, primary.shape[1])

    def across(self, primary: Gray, assistant: Gray, H_a_p: Float, uv: Float32) -> Found:
        """See tracks.Matching; raises BackboneError."""
        return _twice_seen(self._across(primary, assistant, H_a_p, uv))

    def match(self, a: Gray, b: Gray, uv: Float32) -> Found:
        """Points uv (N, 2) px of any picture in any other; raises BackboneError.

        Their sigma says how they were found; `measured` are those to build on.
        """
        found = _found(self.net, a, b, uv)
        direct = finished(a, b, uv, found)
        H_b_a = homography(uv, _any_way_up(self.net, a, b, uv, found), a.shape[1])
        if H_b_a is None or are_alike(H_b_a, a):
            return direct
        return _better(direct, self._across(a, b, H_b_a, uv))

    def _across(self, a: Gray, b: Gray, H_b_a: Float, uv: Float32) -> Found:
        if are_alike(H_b_a, a):
            # to features; Lucas-Kanade is as exact as patches are the same
            found = _found(self.net, a, b, uv)
            back, _ = seen_at(np.asarray(np.linalg.inv(H_b_a)), found.uv, a)
            there = finished(a, warped(b, H_b_a, a), uv, replace(found, uv=back))
            return _through(there, H_b_a, b)
        if zoom_of(H_b_a, a) > MUCH_LARGER:
            return self._enlarged(a, b, H_b_a, uv)
        made = [alike for of, H, alike in self._expected if of is b and H is H_b_a]
        alike = made[0] if made else _made_alike(a, b, H_b_a)
        return _through(self._measured(a, alike, uv), H_b_a, b)

    def _enlarged(self, a: Gray, b: Gray, H_b_a: Float, uv: Float32) -> Found:
        """Points of a in b, which shows things larger, and is looked at as it is."""
        start, inside = seen_at(H_b_a, uv, b)
        seen = warped(a, np.asarray(np.linalg.inv(H_b_a)), b)
        there = self._measured(seen, b, start[inside])
        return _with(Found(start, inside, np.ones(len(uv), np.float32), inside), inside, there)

    def _measured(self, a: Gray, b: Gray, uv: Float32) -> Found:
        return finished(a, b, uv, _found(self.net, a, b, uv))


def _made_alike(a: Gray, b: Gray, H_b_a: Float) -> Gray:
    """The second picture as its features are computed: as it is, or as the first would show it."""
    as_it_is = are_alike(H_b_a, a) or zoom_of(H_b_a, a) > MUCH_LARGER
    return b if as_it_is else warped(b, H_b_a, a)


def finished(a: Gray, b: Gray, uv: Float32, found: Found) -> Found:
    """Matches of uv (N, 2) px, measured on pictures that are alike.

    Two witnesses: where Lucas-Kanade and the features disagree, neither is believed. Where the
    features say nothing, Lucas-Kanade from what neighbours do may stand for itself, less sure; so
    may they, where there is nothing to measure.
    """
    near = MAX_SIGMAS * found.sigma_px
    moved, ok = follow(a, b, uv, found.uv, FROM_FEATURES)
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
    if len(uv) == 0:
        return features_px
    half, _ = follow_ahead(a, b, uv, moved, HALF_WINDOW)
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


def _better(one: Found, other: Found) -> Found:
    """Of each of N points what is measured, sure, or at least surer."""
    rank = [np.where(f.measured, 0, np.where(f.sure, 1, 2)) for f in (one, other)]
    take = (rank[1] < rank[0]) | ((rank[1] == rank[0]) & (other.sigma_px < one.sigma_px))
    part = Found(other.uv[take], other.sure[take], other.sigma_px[take], other.measured[take])
    return _with(one, take, part)


def _with(found: Found, rows: Bool, part: Found) -> Found:
    """N matches, of which R rows (N,) are those of `part`."""
    out = Found(found.uv.copy(), found.sure.copy(), found.sigma_px.copy(), found.measured.copy())
    out.uv[rows], out.sure[rows] = part.uv, part.sure
    out.sigma_px[rows], out.measured[rows] = part.sigma_px, part.measured
    return out


def _twice_seen(found: Found) -> Found:
    """Only what is measured: wrong matches cost a bundle more than missing ones."""
    return replace(found, sure=found.measured)


def _found(net: FeatureNet, a: Gray, b: Gray, uv: Float32) -> Found:
    features_a, features_b = net.of([a, b])
    return find(net, features_a, features_b, uv)


def _any_way_up(net: FeatureNet, a: Gray, b: Gray, uv: Float32, found: Found) -> Found:
    """Points of a in b, found as they are; where few agree, the best of turns and zooms of b."""
    best = found
    most = agreeing(uv, best, b.shape[1])
    if most >= ENOUGH_AGREE * len(uv):
        return best
    for turn, zoom in product(TURNS_DEG, ZOOMS):
        if (turn, zoom) != (0.0, 1.0):
            H_b_a = turned(a, b, turn, zoom)
            there = _through(_found(net, a, warped(b, H_b_a, a), uv), H_b_a, b)
            agree = agreeing(uv, there, b.shape[1])
            if agree > most:
                best, most = there, agree
    return best


def _through(found: Found, H_b_a: Float, b: Gray) -> Found:
    """What was found in b as warped, in b; what lies outside is none.

    Sigma stays as it was there: weighing the eyes less would leave their distance to the rest.
    """
    uv, inside = seen_at(H_b_a, found.uv, b)
    return Found(uv, found.sure & inside, found.sigma_px, found.measured & inside)


def matcher(name: str = "calm-geo") -> LearnedMatching:
    """Open a model for matching; raises BackboneError."""
    return LearnedMatching(FeatureNet.of_model(name))


def place(name: str = "calm-geo") -> LearnedPlace:
    """Open a model for place descriptors; raises BackboneError."""
    return LearnedPlace(FeatureNet.of_model(name))
