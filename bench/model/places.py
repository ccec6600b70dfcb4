"""Metrics of place recognition, and the SIFT-VLAD descriptor.

VLAD: Jegou et al., "Aggregating local descriptors into a compact image representation", 2010.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from calm_edge.geometry import sift
from calm_edge.types import Bytes, Float, Float32

# Two pictures show the same place if nearer than this in position and in optical axis.
NEAR_M, TURN_DEG = 10.0, 30.0
PRECISION = 0.99
WORDS, FEATURES = 64, 500


def same_place(T_w_c: Float, min_gap: int) -> NDArray[np.bool_]:
    """Mask (N, N): picture i (row) shows the same place as picture j (column), which is earlier.

    min_gap: minimum of i - j.
    """
    centre, ahead = T_w_c[:, :3, 3], T_w_c[:, :3, 2]
    near = np.linalg.norm(centre[:, None] - centre[None], axis=2) <= NEAR_M
    alike = ahead @ ahead.T >= np.cos(np.radians(TURN_DEG))
    return np.asarray(near & alike & earlier(len(T_w_c), min_gap))


def earlier(count: int, min_gap: int) -> NDArray[np.bool_]:
    """Mask (N, N): picture j (column) is at least min_gap pictures before picture i (row)."""
    step = np.arange(count)
    return np.asarray(step[:, None] - step[None] >= min_gap)


def found_again(
    likeness: Float, same: NDArray[np.bool_], allowed: NDArray[np.bool_], precision: float
) -> NDArray[np.bool_]:
    """Mask (N,) of pictures whose best candidate is accepted and correct.

    likeness: (N, N), rows are queries. same, allowed: (N, N) correct and possible candidates. Best
    candidates above a threshold of likeness are accepted; it is the lowest one at which a share
    `precision` of those accepted is correct.
    """
    ask = allowed.any(1)
    best = np.where(allowed, likeness, -np.inf).argmax(1)
    rows = np.flatnonzero(ask)
    value, right = likeness[rows, best[rows]], same[rows, best[rows]]
    order = np.argsort(-value, kind="stable")
    correct = np.cumsum(right[order])
    count = np.arange(1, len(rows) + 1)
    # pictures of equal likeness are accepted together
    last = np.append(np.diff(value[order]) != 0, True)
    good = last & (correct >= precision * count)
    found = np.zeros(len(likeness), bool)
    if good.any():
        accepted = order[: np.flatnonzero(good)[-1] + 1]
        found[rows[accepted]] = right[accepted]
    return found


class SiftVlad:
    """VLAD: vector of locally aggregated SIFT descriptors. Its visual words are trained first."""

    min_similarity = 0.0

    def __init__(self, pictures: list[Bytes], words: int = WORDS, seed: int = 0) -> None:
        """Cluster the visual words.

        pictures: (H, W, 3) BGR of other drives, with at least `words` features in all.
        """
        vector = np.concatenate([_vectors(picture) for picture in pictures])
        cv2.setRNGSeed(seed)
        criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 20, 1e-3)
        labels = np.zeros((len(vector), 1), np.int32)
        _, _, centres = cv2.kmeans(vector, words, labels, criteria, 1, cv2.KMEANS_PP_CENTERS)
        self.words = np.asarray(centres, np.float32)

    def describe(self, image: Bytes) -> Float32:
        """VLAD vector (words * 128,) of a picture (H, W, 3) BGR.

        Normalised by word, then as a whole.
        """
        vector = _vectors(image)
        total: NDArray[np.float32] = np.zeros_like(self.words)
        if len(vector):
            # nearest word by |x - c|^2, without the constant term |x|^2
            nearest = ((self.words**2).sum(1) - 2 * vector @ self.words.T).argmin(1)
            np.add.at(total, nearest, vector - self.words[nearest])
        total /= np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-9)
        flat = total.ravel()
        return np.asarray(flat / max(float(np.linalg.norm(flat)), 1e-9), np.float32)

    def similarity(self, queries: Float32, places: Float32) -> Float32:
        """Cosine similarity (Q, P) of vectors `queries` (Q, D) and `places` (P, D)."""
        return np.asarray(queries @ places.T, np.float32)


def _vectors(image: Bytes) -> Float32:
    gray = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)
    return sift.detect(gray, FEATURES).vector
