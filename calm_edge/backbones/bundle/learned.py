"""Learned matches refined to sub-pixel accuracy by Lucas-Kanade.

The features match a point however far it moved, and Lucas-Kanade refines its position. Where
pictures are rotated or zoomed against each other, one is warped to look like the other and matched
again.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product, zip_longest

import numpy as np

from calm_edge.backbones.bundle.correspond import find
from calm_edge.backbones.bundle.edges import edges
from calm_edge.backbones.bundle.features import FeatureNet
from calm_edge.backbones.bundle.matching import Bool, Matches
from calm_edge.backbones.bundle.place import LearnedPlace
from calm_edge.backbones.bundle.refine import refined
from calm_edge.backbones.bundle.tracks import detect_corners, sift_homography
from calm_edge.backbones.bundle.warp import (
    agreeing,
    are_alike,
    homography,
    seen_at,
    turned,
    warped,
    zoom_of,
)
from calm_edge.geometry.flow import Gray, long_side
from calm_edge.types import Float, Float32

# Share of the error that does not count along an edge, above which a point is none of a corner.
MOST_EDGE = 0.9
# Above this zoom the smaller picture is enlarged instead of the larger one shrunk, which would lose
# too much detail; below it enlarging costs more accuracy, by the blur.
MUCH_LARGER = 1.5
# If the matches of fewer points than this share fit one similarity transform, rotated and zoomed
# versions of the second picture are tried.
ENOUGH_AGREE = 0.5
TURNS_DEG, ZOOMS = (-20.0, 0.0, 20.0), (0.5, 1.0, 2.0)


class LearnedMatching:
    """Match pictures by a network's features and Lucas-Kanade: implements protocol `Matching`."""

    def __init__(self, net: FeatureNet) -> None:
        self.net = net
        # pictures of the assistant passed to `expect`, with H_a_p, and warped by it if that helps
        self._expected: list[tuple[Gray, Float, Gray]] = []

    def expect(self, primary: list[Gray], assistant: list[Gray], H_a_p: Float | None) -> None:
        """Start encoding pictures to be matched. H_a_p: primary to assistant px, or None."""
        self._expected = []
        if H_a_p is not None:
            a = primary[0]
            self._expected = [(b, H_a_p, _made_alike(a, b, H_a_p)) for b in assistant]
        # encode in the order of matching: the two cameras alternately
        for pair in zip_longest(primary, (alike for _, _, alike in self._expected)):
            self.net.begin([picture for picture in pair if picture is not None])

    def along(self, source: Gray, target: Gray, uv: Float32) -> Matches:
        """Match uv (N, 2) px to a later picture of the same camera; raises BackboneError."""
        # a match along an edge counts across it, so it does not matter which
        corner = np.square(edges(source, uv)).sum(1) < MOST_EDGE
        found = _found(self.net, source, target, uv, corner)
        return _only_measured(refined(source, target, uv, found))

    def homography(self, primary: Gray, assistant: Gray) -> Float | None:
        """Rough H_a_p (3, 3), primary to assistant px; None if not found; raises BackboneError.

        SIFT first: its few matches are mostly far away, where rotation and zoom show, while most
        learned ones lie on the road.
        """
        rough = sift_homography(primary, assistant)
        if rough is not None:
            return rough
        uv = detect_corners(primary, np.zeros((0, 2), np.float32))
        found = _found(self.net, primary, assistant, uv)
        found = _rotated_or_zoomed(self.net, primary, assistant, uv, found)
        return homography(uv, found, long_side(primary))

    def across(self, primary: Gray, assistant: Gray, H_a_p: Float, uv: Float32) -> Matches:
        """Match primary points uv (N, 2) px to the assistant's picture; raises BackboneError."""
        return _only_measured(self._across(primary, assistant, H_a_p, uv))

    def match(self, a: Gray, b: Gray, uv: Float32) -> Matches:
        """Match points uv (N, 2) px of any picture to any other; raises BackboneError."""
        found = _found(self.net, a, b, uv)
        direct = refined(a, b, uv, found)
        H_b_a = homography(uv, _rotated_or_zoomed(self.net, a, b, uv, found), long_side(a))
        if H_b_a is None or are_alike(H_b_a, a):
            return direct
        return _better(direct, self._across(a, b, H_b_a, uv))

    def _across(self, a: Gray, b: Gray, H_b_a: Float, uv: Float32) -> Matches:
        if are_alike(H_b_a, a):
            # the features need no warp, but Lucas-Kanade is more accurate with it
            found = _found(self.net, a, b, uv)
            back, _ = seen_at(np.asarray(np.linalg.inv(H_b_a)), found.uv, a)
            there = refined(a, warped(b, H_b_a, a), uv, replace(found, uv=back))
            return _through(there, H_b_a, b)
        if zoom_of(H_b_a, a) > MUCH_LARGER:
            return self._enlarged(a, b, H_b_a, uv)
        made = [alike for of, H, alike in self._expected if of is b and H is H_b_a]
        alike = made[0] if made else _made_alike(a, b, H_b_a)
        return _through(self._measured(a, alike, uv), H_b_a, b)

    def _enlarged(self, a: Gray, b: Gray, H_b_a: Float, uv: Float32) -> Matches:
        """Match points of a to b, which shows the scene larger: a is enlarged first."""
        start, inside = seen_at(H_b_a, uv, b)
        seen = warped(a, np.asarray(np.linalg.inv(H_b_a)), b)
        there = self._measured(seen, b, start[inside])
        return _with(Matches(start, inside, np.ones(len(uv), np.float32), inside), inside, there)

    def _measured(self, a: Gray, b: Gray, uv: Float32) -> Matches:
        return refined(a, b, uv, _found(self.net, a, b, uv))


def _made_alike(a: Gray, b: Gray, H_b_a: Float) -> Gray:
    """Picture b warped by H_b_a to look like a; b itself if they are alike or b is much larger."""
    as_it_is = are_alike(H_b_a, a) or zoom_of(H_b_a, a) > MUCH_LARGER
    return b if as_it_is else warped(b, H_b_a, a)


def _better(one: Matches, other: Matches) -> Matches:
    """Better of two matches of each of N points: measured before sure before unsure ones.

    Of two of the same rank the one with the smaller sigma.
    """
    rank = [np.where(f.measured, 0, np.where(f.sure, 1, 2)) for f in (one, other)]
    take = (rank[1] < rank[0]) | ((rank[1] == rank[0]) & (other.sigma_px < one.sigma_px))
    part = Matches(other.uv[take], other.sure[take], other.sigma_px[take], other.measured[take])
    return _with(one, take, part)


def _with(found: Matches, rows: Bool, part: Matches) -> Matches:
    """N matches with those at rows (N,) bool replaced by `part`."""
    out = Matches(found.uv.copy(), found.sure.copy(), found.sigma_px.copy(), found.measured.copy())
    out.uv[rows], out.sure[rows] = part.uv, part.sure
    out.sigma_px[rows], out.measured[rows] = part.sigma_px, part.measured
    return out


def _only_measured(found: Matches) -> Matches:
    """Count only refined matches as sure: a wrong one harms bundle adjustment more than none."""
    return replace(found, sure=found.measured)


def _found(net: FeatureNet, a: Gray, b: Gray, uv: Float32, corner: Bool | None = None) -> Matches:
    features_a, features_b = net.of([a, b])
    return find(net, features_a, features_b, uv, corner)


def _rotated_or_zoomed(net: FeatureNet, a: Gray, b: Gray, uv: Float32, found: Matches) -> Matches:
    """Matches of a in b; if few agree, the best of those in rotated and zoomed versions of b.

    uv: (N, 2) px of a. found: their matches in b as it is.
    """
    best = found
    most = agreeing(uv, best, long_side(b))
    if most >= ENOUGH_AGREE * len(uv):
        return best
    for turn, zoom in product(TURNS_DEG, ZOOMS):
        if (turn, zoom) != (0.0, 1.0):
            H_b_a = turned(a, b, turn, zoom)
            there = _through(_found(net, a, warped(b, H_b_a, a), uv), H_b_a, b)
            agree = agreeing(uv, there, long_side(b))
            if agree > most:
                best, most = there, agree
    return best


def _through(found: Matches, H_b_a: Float, b: Gray) -> Matches:
    """Map matches in a b warped by H_b_a back to b; those outside of it become unsure.

    Sigma is not scaled with the zoom: matches between the cameras keep their weight.
    """
    uv, inside = seen_at(H_b_a, found.uv, b)
    return Matches(uv, found.sure & inside, found.sigma_px, found.measured & inside)


def matcher(name: str = "calm-geo") -> LearnedMatching:
    """Open a model for matching; raises BackboneError."""
    return LearnedMatching(FeatureNet.of_model(name))


def place(name: str = "calm-geo") -> LearnedPlace:
    """Open a model for place descriptors; raises BackboneError."""
    return LearnedPlace(FeatureNet.of_model(name))
