"""Global image descriptors for place recognition (paper IV-D).

The paper uses SALAD. The default here needs no weights: histograms of gradient orientations on a
lattice of cells, as in HOG (Dalal and Triggs, 2005). It is invariant to exposure but not to
viewpoint: returns in the same direction are found, others are not. Learned descriptors implement
the same protocol, e.g. that of bundle's network (`bundle/place`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, Protocol, runtime_checkable

import cv2
import numpy as np

from calm_edge.config import ConfigError
from calm_edge.types import Bytes, Float32

COLUMNS, ROWS, BINS = 20, 6, 8
CELL_PX = 8
# Gradients below this, in grey levels (of 255) per pixel, are mostly sensor noise and damped.
NOISE_FLOOR = 4.0
# Sideways shifts [columns] that are tried, since lane and heading of a return differ a little.
SHIFTS = (-2, -1, 0, 1, 2)


class PlaceDescriptor(Protocol):
    """A global image descriptor and its similarity.

    min_similarity: places less similar than this are no loop candidates.
    """

    min_similarity: float

    def describe(self, image: Bytes) -> Float32:
        """Descriptor (D,) of unit length of an image (H, W, 3) uint8 BGR; thread-safe."""
        ...

    def similarity(self, queries: Float32, places: Float32) -> Float32:
        """Similarities (Q, P) of descriptors (Q, D) and (P, D); larger is more similar."""
        ...


@runtime_checkable
class DescribesPlaces(Protocol):
    """Backbone that may provide a learned descriptor."""

    @property
    def places(self) -> PlaceDescriptor | None:
        """Learned descriptor, or None."""
        ...


class GradientLayout:
    """Descriptor of gradient orientation histograms on a lattice of cells, normalised per cell."""

    min_similarity = 0.5

    def describe(self, image: Bytes) -> Float32:
        """Descriptor (ROWS * COLUMNS * BINS,) of unit length, row-major, of (H, W, 3) uint8 BGR."""
        small = cv2.resize(
            cv2.cvtColor(image, cv2.COLOR_BGR2GRAY),
            (COLUMNS * CELL_PX, ROWS * CELL_PX),
            interpolation=cv2.INTER_AREA,
        )
        x = cv2.Sobel(small, cv2.CV_32F, 1, 0, ksize=3, scale=0.25)
        y = cv2.Sobel(small, cv2.CV_32F, 0, 1, ksize=3, scale=0.25)
        size, angle = cv2.cartToPolar(x, y)
        # a pixel votes for the two nearest signed orientations (linear interpolation)
        place = np.asarray(angle, np.float32) * np.float32(BINS / (2 * np.pi))
        lower = np.floor(place).astype(np.int64)
        upper_share = place - lower
        cell = np.arange(ROWS * COLUMNS).reshape(ROWS, COLUMNS)
        cell = cell.repeat(CELL_PX, 0).repeat(CELL_PX, 1)
        votes = np.zeros(ROWS * COLUMNS * BINS)
        for orientation, share in ((lower, 1 - upper_share), (lower + 1, upper_share)):
            index = cell * BINS + orientation % BINS
            votes += np.bincount(index.ravel(), (size * share).ravel(), len(votes))
        cells = np.sqrt(votes.reshape(-1, BINS))
        floor = np.sqrt(NOISE_FLOOR * CELL_PX**2)
        cells /= np.hypot(np.linalg.norm(cells, axis=1, keepdims=True), floor)
        flat = cells.ravel()
        length = np.linalg.norm(flat)
        unit = flat / length if length > 0 else np.full(len(flat), len(flat) ** -0.5)
        return np.asarray(unit, np.float32)

    def similarity(self, queries: Float32, places: Float32) -> Float32:
        """Cosine similarity (Q, P) of (Q, D) and (P, D), the largest over a few sideways shifts."""
        a, b = (each.reshape(len(each), ROWS, COLUMNS, BINS) for each in (queries, places))
        return layout_likeness(a, b, SHIFTS)


def layout_likeness(queries: Float32, places: Float32, shifts: Sequence[int]) -> Float32:
    """Cosine similarity (Q, P) of two sets of lattices, the largest over sideways shifts [columns].

    queries: Q lattices (Q, rows, columns, D) with D values per cell. places: P lattices (P, rows,
    columns, D). The mean over all places is subtracted first, since it does not distinguish them.
    """
    common = places.mean(0) if len(places) > 1 else np.zeros(places.shape[1:], np.float32)
    a, b, columns = queries - common, places - common, places.shape[2]
    best = np.full((len(queries), len(places)), -np.inf, np.float32)
    for shift in shifts:
        moved = a[:, :, max(0, shift) : columns + min(0, shift)]
        still = b[:, :, max(0, -shift) : columns + min(0, -shift)]
        best = np.maximum(best, _unit(moved) @ _unit(still).T)
    return np.asarray(best, np.float32)


def descriptor_of(
    backbone: object, asked: Literal["auto", "gradients", "learned"]
) -> PlaceDescriptor:
    """Select the descriptor of a drive; auto: the learned one of the backbone if it has one.

    Raises ConfigError if a learned one is requested and there is none.
    """
    own = backbone.places if isinstance(backbone, DescribesPlaces) else None
    if asked == "learned" and own is None:
        raise ConfigError(
            "loops.descriptor=learned: this backbone has no learned descriptor; "
            "set auto, or backbone.name=bundle:calm-geo"
        )
    return GradientLayout() if own is None or asked == "gradients" else own


def _unit(cells: Float32) -> Float32:
    rows = cells.reshape(len(cells), -1)
    return np.asarray(rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-9))
