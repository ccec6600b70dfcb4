"""Vocabulary tree of binary words in DBoW2's text format, trained on frames of one drive.

ORB-SLAM3 requires a vocabulary, and the pip package does not contain the published one of 139 MB.
One of a single drive suffices for tracking (reference keyframes, relocalisation), not for loop
closing.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from calm_edge.types import Bytes, Int
from device.atomic_file import replace_text

BRANCHES = 10
LEVELS = 4
FRAMES = 30
FEATURES = 1000


def describe(pictures: Sequence[Path], features: int = FEATURES) -> tuple[Bytes, Int]:
    """ORB descriptors (M, 32) of pictures, and the index (M,) of the picture of each."""
    orb = cv2.ORB_create(nfeatures=features)  # type: ignore[attr-defined]
    rows, source = [], []
    for k, path in enumerate(pictures):
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        found = None if image is None else orb.detectAndCompute(image, None)[1]
        if found is not None:
            rows.append(np.asarray(found, np.uint8))
            source.append(np.full(len(found), k))
    if not rows:
        return np.zeros((0, 32), np.uint8), np.zeros(0, np.int64)
    return np.concatenate(rows), np.concatenate(source)


def _split(bits: np.ndarray, rng_state: int) -> tuple[Bytes, Int]:
    """Cluster descriptor bits (M, 256) in {0, 1} into up to BRANCHES binary centres (k, 32).

    Also returns the centre's index of each row (M,).
    """
    k = min(BRANCHES, len(bits))
    cv2.setRNGSeed(rng_state)
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 10, 1e-3)
    centre_bits = cv2.kmeans(bits, k, None, stop, 1, cv2.KMEANS_PP_CENTERS)[2]  # type: ignore[call-overload]
    words = np.packbits(np.asarray(centre_bits) > 0.5, axis=1)
    # assign rows to the nearest of the rounded centres, as ORB-SLAM3 does
    distance = bits @ (1 - 2 * np.unpackbits(words, axis=1).astype(np.float32)).T
    distance += np.unpackbits(words, axis=1).sum(1)
    return words, distance.argmin(1)


def grow(descriptors: Bytes, source: Int) -> str:
    """Text of the vocabulary tree: `k L scoring weighting`, then a line for each node.

    Node: `parent leaf 32-bytes weight`. descriptors: (M, 32). source: (M,) index of the picture.
    The weight of a word is its inverse document frequency, log(pictures / pictures that contain
    it).
    """
    bits = np.unpackbits(descriptors, axis=1).astype(np.float32)
    pictures = len(np.unique(source))
    lines = [f"{BRANCHES} {LEVELS} 0 0"]
    queue = [(np.arange(len(bits)), 0, 1)]
    nodes = 0
    while queue:
        rows, parent, level = queue.pop(0)
        words, owner = _split(bits[rows], rng_state=nodes + 1)
        for j, word in enumerate(words):
            mine = rows[owner == j]
            nodes += 1
            leaf = level == LEVELS or len(mine) <= BRANCHES
            shown = max(len(np.unique(source[mine])), 1)
            weight = np.log(pictures / shown) if leaf else 0.0
            code = " ".join(map(str, word))
            lines.append(f"{parent} {int(leaf)} {code} {weight:.6f}")
            if not leaf:
                queue.append((mine, nodes, level + 1))
    return "\n".join(lines) + "\n"


def vocabulary_of(pictures: Sequence[Path], where: Path) -> Path:
    """Write a vocabulary of FRAMES evenly spread pictures to `where`, unless it exists.

    Returns `where`.
    """
    if not where.is_file():
        some = [pictures[i] for i in np.linspace(0, len(pictures) - 1, FRAMES).astype(int)]
        where.parent.mkdir(parents=True, exist_ok=True)
        replace_text(where, grow(*describe(some)))
    return where
