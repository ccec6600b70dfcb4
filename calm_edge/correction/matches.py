"""Pixels that two views of a batch share: what fundamental matrices are estimated from (V-A)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np

from calm_edge.geometry import sift
from calm_edge.types import Bytes, Float, Float32, Int, Landmarks


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
    """SIFT features of some views, by view."""

    features: dict[int, sift.Features]

    def pair(self, view_a: int, view_b: int) -> tuple[Float, Float]:
        """Pixels of mutual best matches that pass the ratio test, each (M, 2)."""
        a, b = self.features[view_a], self.features[view_b]
        in_a, in_b = sift.match(a, b).T
        return a.uv[in_a].astype(np.float64), b.uv[in_b].astype(np.float64)


def from_sift(images: Sequence[Bytes], views: Sequence[int], max_features: int) -> SiftMatches:
    """The matches of images (H, W, 3) BGR by at most max_features each; views: their indices."""
    features = {}
    for image, view in zip(images, views, strict=True):
        gray = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)
        features[view] = sift.detect(gray, max_features)
    return SiftMatches(features)
