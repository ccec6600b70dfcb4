"""Matches between views of a batch, for the estimation of fundamental matrices (paper V-A).

Their pixels are those of the pictures as taken; `undistorted` gives those of a pinhole camera.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np

from calm_edge.geometry import sift
from calm_edge.geometry.camera import Camera
from calm_edge.types import Bytes, Float, Float32, Int, Landmarks


class PairMatches(Protocol):
    """Matches between any two views of a batch, given by their batch indices."""

    def pair(self, view_a: int, view_b: int) -> tuple[Float, Float]:
        """Matched pixels uv_a (M, 2), uv_b (M, 2) of the full images."""
        ...


@dataclass(frozen=True, slots=True)
class LandmarkMatches:
    """Matches from the backbone's landmarks.

    For each view, index: sorted ids (O,) of its landmarks; uv: their pixels (O, 2).
    """

    index: dict[int, Int]
    uv: dict[int, Float32]

    def pair(self, view_a: int, view_b: int) -> tuple[Float, Float]:
        """Pixels (M, 2), (M, 2) of the landmarks observed in both views."""
        if view_a not in self.index or view_b not in self.index:
            return np.zeros((0, 2)), np.zeros((0, 2))
        _, in_a, in_b = np.intersect1d(
            self.index[view_a], self.index[view_b], assume_unique=True, return_indices=True
        )
        return self.uv[view_a][in_a].astype(np.float64), self.uv[view_b][in_b].astype(np.float64)


def from_landmarks(landmarks: Landmarks, views: Sequence[int] | None = None) -> LandmarkMatches:
    """Matches between all views, or between the given ones."""
    index, pixels = dict[int, Int](), dict[int, Float32]()
    for view in np.unique(landmarks.view) if views is None else views:
        (rows,) = np.nonzero(landmarks.view == view)
        seen, first = np.unique(landmarks.index[rows], return_index=True)
        index[int(view)], pixels[int(view)] = seen, landmarks.uv[rows[first]]
    return LandmarkMatches(index, pixels)


@dataclass(frozen=True, slots=True)
class SiftMatches:
    """Matches of SIFT features. features: those of each view, by its batch index."""

    features: dict[int, sift.Features]

    def pair(self, view_a: int, view_b: int) -> tuple[Float, Float]:
        """Pixels (M, 2), (M, 2) of mutual nearest neighbours that pass the ratio test."""
        a, b = self.features[view_a], self.features[view_b]
        in_a, in_b = sift.match(a, b).T
        return a.uv[in_a].astype(np.float64), b.uv[in_b].astype(np.float64)


def from_sift(images: Sequence[Bytes], views: Sequence[int], max_features: int) -> SiftMatches:
    """Matches of images (H, W, 3) BGR by up to max_features SIFT features each.

    views: batch indices of the images.
    """
    features = {}
    for image, view in zip(images, views, strict=True):
        gray = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)
        features[view] = sift.detect(gray, max_features)
    return SiftMatches(features)


@dataclass(frozen=True, slots=True)
class StoredMatches:
    """Matches of the pairs of views (view_a, view_b) that were stored: pixels (M, 2), (M, 2)."""

    pixels: dict[tuple[int, int], tuple[Float, Float]]

    def pair(self, view_a: int, view_b: int) -> tuple[Float, Float]:
        """Pixels as stored."""
        return self.pixels[view_a, view_b]


def undistorted(camera: Camera, uv_a: Float, uv_b: Float) -> tuple[Float, Float]:
    """Undistort matches (M, 2), (M, 2) of one camera, without those beyond its lens."""
    uv_a, uv_b = camera.undistorted(uv_a), camera.undistorted(uv_b)
    seen = np.isfinite(uv_a).all(1) & np.isfinite(uv_b).all(1)
    return uv_a[seen], uv_b[seen]
