"""Pixels that two views of a batch share: what fundamental matrices are estimated from (V-A)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np

from calm_edge.types import Bytes, Float, Float32, Int, Landmarks

# Lowe's: the best descriptor must be this much nearer than the second best
_RATIO = 0.8
_NO_FEATURES = np.zeros((0, 128), np.float32)


class PairMatches(Protocol):
    """The matches within one batch; `view` is the batch index of an image."""

    def pair(self, view_a: int, view_b: int) -> tuple[Float, Float]:
        """uv_a (M, 2), uv_b (M, 2) px of the full image."""
        ...


@dataclass(frozen=True, slots=True)
class LandmarkMatches:
    """A backbone's own matches. index / uv: view -> landmarks (O,), sorted, and px (O, 2)."""

    index: dict[int, Int]
    uv: dict[int, Float32]

    def pair(self, view_a: int, view_b: int) -> tuple[Float, Float]:
        """Pixels of the landmarks both views saw, each (M, 2)."""
        if view_a not in self.index or view_b not in self.index:
            return np.zeros((0, 2)), np.zeros((0, 2))
        _, in_a, in_b = np.intersect1d(
            self.index[view_a], self.index[view_b], assume_unique=True, return_indices=True
        )
        return self.uv[view_a][in_a].astype(np.float64), self.uv[view_b][in_b].astype(np.float64)


def from_landmarks(landmarks: Landmarks, views: Sequence[int] | None = None) -> LandmarkMatches:
    """The matches of all views, or of the given ones."""
    index, pixels = dict[int, Int](), dict[int, Float32]()
    for view in np.unique(landmarks.view) if views is None else views:
        (rows,) = np.nonzero(landmarks.view == view)
        seen, first = np.unique(landmarks.index[rows], return_index=True)
        index[int(view)], pixels[int(view)] = seen, landmarks.uv[rows[first]]
    return LandmarkMatches(index, pixels)


@dataclass(frozen=True, slots=True)
class SiftMatches:
    """SIFT features of some views: view -> px (Q, 2) and unit descriptors (Q, 128)."""

    uv: dict[int, Float32]
    descriptors: dict[int, Float32]

    def pair(self, view_a: int, view_b: int) -> tuple[Float, Float]:
        """Pixels of mutual best matches that pass the ratio test both ways, each (M, 2)."""
        in_a, in_b = _mutual(self.descriptors[view_a], self.descriptors[view_b])
        return self.uv[view_a][in_a].astype(np.float64), self.uv[view_b][in_b].astype(np.float64)


class SiftMatcher:
    """Describes images by at most max_features SIFT features each."""

    def __init__(self, max_features: int) -> None:
        # without the precise upscaling every feature lies a quarter of a pixel off
        self._sift = cv2.SIFT.create(nfeatures=max_features, enable_precise_upscale=True)
        self._max_features = max_features

    def describe(self, images: Sequence[Bytes], views: Sequence[int]) -> SiftMatches:
        """Features of images (H, W, 3) BGR or (H, W) gray, each known by its view."""
        uv, descriptors = dict[int, Float32](), dict[int, Float32]()
        for image, view in zip(images, views, strict=True):
            gray = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
            points, found = self._sift.detectAndCompute(gray, None)
            # ties of the weakest response come on top of the number asked for
            kept = slice(None, self._max_features)
            pixels = np.array([point.pt for point in points], np.float32).reshape(-1, 2)
            found = _NO_FEATURES if found is None else np.asarray(found, np.float32)
            size = np.maximum(np.linalg.norm(found, axis=1, keepdims=True), 1e-9)
            uv[view], descriptors[view] = pixels[kept], (found / size)[kept]
        return SiftMatches(uv, descriptors)


def _mutual(a: Float32, b: Float32) -> tuple[Int, Int]:
    """Rows of unit descriptors a (Q, 128), b (R, 128) that are each other's clear best."""
    if len(a) < 2 or len(b) < 2:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    distance2 = np.maximum(2 - 2 * (a @ b.T), 0)
    best_b = distance2.argmin(1)
    best_a = distance2.argmin(0)
    rows = np.arange(len(a))
    clear = (best_a[best_b] == rows) & _is_clear(distance2)[rows]
    clear &= _is_clear(distance2.T)[best_b]
    return rows[clear], best_b[clear]


def _is_clear(distance2: Float32) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """(Q,) whether the best of each row of (Q, R) passes the ratio test."""
    nearest = np.partition(distance2, 1, axis=1)[:, :2]
    return np.asarray(nearest[:, 0] < _RATIO**2 * nearest[:, 1])
