"""Classical matchers of given query points: SIFT, KLT, and KLT after a homography."""

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

# A query point within this distance of a SIFT keypoint takes its scale and orientation.
SAME_PX = 1.0
# Candidates this near to the best one show the same point; the ratio test skips them.
RIVAL_PX = 3.0
# Number of best candidates among which the ratio test seeks a second point.
DEEP = 12
MAX_KEYPOINTS, MAX_CORNERS = 4000, 1000
KEPT_PICTURES = 4


class SiftMatcher:
    """Match RootSIFT descriptors with the ratio test.

    A query point at a SIFT keypoint takes its scale and orientation; any other is described at
    three scales. Candidates in the other picture are its SIFT keypoints, and corners at three
    scales.
    """

    def __init__(self) -> None:
        self._kept: OrderedDict[int, tuple[Bytes, described.Described]] = OrderedDict()

    def match(self, image_a: Bytes, image_b: Bytes, query_uv: Float) -> Matches:
        """Find the query points in image_b, see Matcher."""
        query = self._queries(described.gray_of(image_a), query_uv)
        there = self._candidates(image_b)
        n = len(query_uv)
        uv_b, ratio = np.zeros((n, 2)), np.full(n, np.inf)
        if len(there.uv) > DEEP and len(query.uv):
            # squared distance of unit vectors
            apart = 2 - 2 * (query.vector @ there.vector.T)
            near = np.argpartition(apart, DEEP, axis=1)[:, :DEEP]
            value = np.take_along_axis(apart, near, 1)
            order = value.argsort(1)
            near = np.take_along_axis(near, order, 1)
            value = np.maximum(np.take_along_axis(value, order, 1), 1e-9)
            at = there.uv[near]
            rival = np.linalg.norm(at - at[:, :1], axis=2) > RIVAL_PX
            # if all candidates show one point, a second point is at least as far as the last
            first = np.where(rival.any(1), rival.argmax(1), DEEP - 1)
            clear = value[:, 0] / value[np.arange(len(value)), first]
            # worst first, so that the best description of a query point overwrites others
            for row in clear.argsort()[::-1]:
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
        """Describe the candidates in a picture.

        The results of the last few pictures are cached, since several pairs share a picture.
        """
        known = self._kept.get(id(image))
        if known is None or known[0] is not image:
            gray = described.gray_of(image)
            points = described.at_points(gray, described.corners(gray, MAX_CORNERS))
            found = described.describe(gray, [*described.keypoints(gray, MAX_KEYPOINTS), *points])
            # holding the picture keeps its id from being reused
            known = self._kept[id(image)] = (image, found)
            while len(self._kept) > KEPT_PICTURES:
                self._kept.popitem(last=False)
        return known[1]


class KltMatcher:
    """Pyramidal Lucas-Kanade with a backward check, with the settings of bundle's tracks.

    A second round starts the points not found from the flow of their neighbours.
    """

    def match(self, image_a: Bytes, image_b: Bytes, query_uv: Float) -> Matches:
        """Find the query points in image_b, see Matcher."""
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

    The homography accounts for zoom and roll. Outliers to a fundamental matrix are dropped, as in
    bundle.
    """

    def match(self, image_a: Bytes, image_b: Bytes, query_uv: Float) -> Matches:
        """Find the query points in image_b, see Matcher; none without enough SIFT matches."""
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
    """Median flow (N, 2) of the five nearest known points, for each point; 0 if none is known."""
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
