"""Place descriptor from the encoder: its global descriptor, and the layout of its features.

Both come from the pass that matching needs anyway. The global descriptor does not depend on where
in the picture things are; the layout distinguishes streets with similar things.
"""

from __future__ import annotations

import numpy as np

from calm_edge.backbones.bundle.features import FeatureNet
from calm_edge.loops.descriptor import layout_likeness
from calm_edge.types import Bytes, Float32

ROWS, COLUMNS, CHANNELS = 4, 10, 64
# Columns that a layout is shifted by to fit: a return is seldom in the same lane and heading.
SHIFTS = (-1, 0, 1)
# Weight of the layout's cosine in the mean; the global descriptor's, the more reliable, has 1.
LAYOUT_WEIGHT = 0.5


class LearnedPlace:
    """The global descriptor with the layout of features, for `loops`."""

    # one per cent of true returns have a lower similarity
    min_similarity = 0.45

    def __init__(self, net: FeatureNet) -> None:
        self._net = net

    def describe(self, image: Bytes) -> Float32:
        """Descriptor (256 + ROWS * COLUMNS * CHANNELS,) of unit length of (H, W, 3) uint8 BGR.

        Contains the global descriptor, then the layout, row by row. Raises BackboneError.
        """
        of = self._net.of([image])[0]
        height, width = of.coarse.shape[:2]
        columns = np.tensordot(of.coarse, _overlap(COLUMNS, width), (1, 1))
        layout = np.tensordot(_overlap(ROWS, height), columns, (1, 0)).swapaxes(1, 2).ravel()
        both = np.concatenate([of.place, layout / np.linalg.norm(layout)])
        return np.asarray(both / np.linalg.norm(both), np.float32)

    def similarity(self, queries: Float32, places: Float32) -> Float32:
        """Similarity (Q, P) of Q queries (Q, D) to P places (P, D), both from `describe`.

        Weighted mean of the cosines of the global descriptors and of the layouts. The layouts' is
        the largest over SHIFTS. The mean over the places is subtracted first, since it does not
        distinguish them.
        """
        q, p = _parts(queries), _parts(places)
        layout = layout_likeness(q[1], p[1], SHIFTS)
        alike = layout_likeness(q[0], p[0], (0,)) + LAYOUT_WEIGHT * layout
        return np.asarray(alike / (1 + LAYOUT_WEIGHT), np.float32)


def _parts(described: Float32) -> tuple[Float32, Float32]:
    """Split descriptors (N, D) into global ones (N, 1, 1, 256) and layouts of features.

    Layouts: (N, rows, columns, channels). A global one has the shape of a layout of one cell.
    """
    n, word = len(described), described.shape[1] - ROWS * COLUMNS * CHANNELS
    layout = described[:, word:].reshape(n, ROWS, COLUMNS, CHANNELS)
    return described[:, :word].reshape(n, 1, 1, word), layout


def _overlap(cells: int, samples: int) -> Float32:
    """Share (cells, samples) of each sample in each cell.

    Samples and cells divide the same length into equal parts.
    """
    edges = np.arange(cells + 1) * samples / cells
    upto = np.clip(edges[:, None] - np.arange(samples), 0, 1)
    return np.asarray(np.diff(upto, axis=0), np.float32)
