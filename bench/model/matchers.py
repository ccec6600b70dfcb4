"""Classical matchers at given query points: SIFT, KLT, and KLT after a homography."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from bench.model import described
from bench.model.protocols import Matcher, Matches
from calm_edge.backbones.bundle.tracks import MATCHING, across_eyes, sift_homography
from calm_edge.geometry.flow import follow
from calm_edge.geometry.sift import RATIO
from calm_edge.types import Bytes, Float, Float32

Bool = NDArray[np.bool_]

# A query within this distance of a SIFT keypoint takes its scale and orientation.
SAME_PX = 1.0
# Candidates within this distance of the best are the same point; the ratio test skips them.
RIVAL_PX = 3.0
# Number of best candidates searched for the second-best point of the ratio test.
DEEP = 12
MAX_KEYPOINTS, MAX_CORNERS = 4000, 1000
KEPT_PICTURES = 4


class SiftMatcher:
    """RootSIFT and the ratio test, on SIFT keypoints and on corners at three scales.

    A query at a keypoint takes its scale and orientation. Any other query is described at three
    scales, as are the corners of the other picture.
    """

    def __init__(self) -> None:
        self._kept: OrderedDict[int, tuple[Bytes, described.Described]] = OrderedDict()

    def match(self, image_a: Bytes, image_b: Bytes, query_uv: Float) -> Matches:
        """See Matcher."""
        query = self._queries(described.gray_of(image_a), query_uv)
        there = self._candidates(image_b)
        n = len(query_uv)
        uv_b, ratio = np.zeros((n, 2)), np.full(n, np.inf)
        if len(there.uv) > DEEP and len(query.uv):
            # unit vectors: the squared distance is 2 - 2 likeness
            apart = 2 - 2 * (query.vector @ there.vector.T)
            near = np.argpartition(apart, DEEP, axis=1)[:, :DEEP]
            value = np.take_along_axis(apart, near, 1)
            order = value.argsort(1)
            near = np.take_along_axis(near, order, 1)
            value = np.maximum(np.take_along_axis(value, order, 1), 1e-9)
            at = there.uv[near]
            rival = np.linalg.norm(at - at[:, :1], axis=2) > RIVAL_PX
            # no second point among them: the last one bounds its distance
            first = np.where(rival.any(1), rival.argmax(1), DEEP - 1)
            clear = value[:, 0] / value[np.arange(len(value)), first]
            for row in clear.argsort()[::-1]:  # the best description of a query overwrites others
                uv_b[query.index[row]], ratio[query.index[row]] = at[row, 0], clear[row]
        return Matches(uv_b, ratio < RATIO**2, np.full(n, np.nan))

    def _queries(self, gray: Bytes, uv: Float) -> described.Described:
        own = described.keypoints(gray, MAX_KEYPOINTS)
        chosen: list[cv2.KeyPoint] = []
        apart = cdist(uv, cv2.KeyPoint.convert(own)) if own else np.full((len(uv), 1), np.inf)
        beside = [np.flatnonzero(row).tolist() for row in apart <= SAME_PX]
        for k, found in enumerate(beside):
            for p in (own[i] for i in found):
                x, y = p.pt
                chosen.append(cv2.KeyPoint(x, y, p.size, p.angle, p.response, p.octave, k))
        bare = np.array([k for k, found in enumerate(beside) if not found], np.int64)
        for p in described.at_points(gray, uv[bare]):
            p.class_id = int(bare[p.class_id])
            chosen.append(p)
        return described.describe(gray, chosen)

    def _candidates(self, image: Bytes) -> described.Described:
        """Descriptors of the other picture; the last few are cached, as pairs share pictures."""
        known = self._kept.get(id(image))
        if known is None or known[0] is not image:
            gray = described.gray_of(image)
            points = described.at_points(gray, described.corners(gray, MAX_CORNERS))
            found = described.describe(gray, [*described.keypoints(gray, MAX_KEYPOINTS), *points])
            # the reference keeps the id from being reused
            known = self._kept[id(image)] = (image, found)
            while len(self._kept) > KEPT_PICTURES:
                self._kept.popitem(last=False)
        return known[1]


class KltMatcher:
    """Pyramidal Lucas-Kanade with a backward check, in the settings of bundle's tracks.

    Two rounds: the second starts from the flow of neighbours found in the first.
    """

    def match(self, image_a: Bytes, image_b: Bytes, query_uv: Float) -> Matches:
        """See Matcher."""
        a, b = described.gray_of(image_a), described.gray_of(image_b)
        uv = np.asarray(query_uv, np.float32)

        def track(guess: Float32) -> tuple[Float32, Bool]:
            return follow(a, b, uv, uv + guess, MATCHING)

        moved, ok = track(np.zeros_like(uv))
        again, ok_again = track(around(uv, moved - uv, ok))
        there = np.where(ok[:, None], moved, again).astype(np.float64)
        return Matches(there, ok | ok_again, np.full(len(uv), np.nan))


class WarpedKltMatcher:
    """Lucas-Kanade after a homography from SIFT matches, as bundle matches between the eyes.

    The homography takes zoom and roll. Outliers to a fundamental matrix are dropped, as there.
    """

    def match(self, image_a: Bytes, image_b: Bytes, query_uv: Float) -> Matches:
        """See Matcher. None is found without enough SIFT matches."""
        a, b = described.gray_of(image_a), described.gray_of(image_b)
        uv, none = np.asarray(query_uv, np.float32), np.full(len(query_uv), np.nan)
        H_b_a = sift_homography(a, b) if len(uv) else None
        if H_b_a is None:
            return Matches(np.zeros((len(uv), 2)), np.zeros(len(uv), bool), none)
        there, ok = across_eyes(a, b, H_b_a, uv, np.zeros_like(uv))
        if ok.any():
            back = cv2.perspectiveTransform(there[None].astype(np.float64), np.linalg.inv(H_b_a))[0]
            guess = around(uv, (back - uv).astype(np.float32), ok)
            again, ok_again = across_eyes(a, b, H_b_a, uv, guess)
            there, ok = np.where(ok[:, None], there, again), ok | ok_again
        return Matches(there.astype(np.float64), ok, none)


def around(uv: Float32, flow: Float32, known: Bool) -> Float32:
    """Median flow (N, 2) of the five known points nearest to each point; 0 without any."""
    if not known.any():
        return np.zeros_like(flow)
    k = min(5, int(known.sum()))
    _, near = cKDTree(uv[known]).query(uv, k=range(1, k + 1))
    return np.asarray(np.median(flow[known][near], axis=1), np.float32)


BASELINES: dict[str, Callable[[], Matcher]] = {
    "SIFT": SiftMatcher,
    "KLT": KltMatcher,
    "KLT warped": WarpedKltMatcher,
}
