"""What a place looks like, as a unit vector: what loop closure looks places up by (paper IV-D).

The paper takes SALAD. This one has nothing to learn or to load: which way the brightness changes,
cell by cell over a small picture. It ignores exposure, not viewpoint: a return in the same lane is
found, one from the other direction is not. A learned descriptor takes its place by the protocol,
as that of bundle's network does (`bundle/place`).
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
# Sensor noise turns weak gradients any way: what is below this, of 255 a pixel, hardly counts.
WEAKEST = 4.0
# A return is seldom in the same line and heading: columns a picture is moved by to fit.
SHIFTS = (-2, -1, 0, 1, 2)


class PlaceDescriptor(Protocol):
    """A picture as a vector, and how alike two are.

    worth_a_look: the similarity below which a place is not even checked by geometry.
    """

    worth_a_look: float

    def describe(self, image: Bytes) -> Float32:
        """(H, W, 3) uint8 BGR -> (D,) of unit length; from several threads at a time."""
        ...

    def similarity(self, queries: Float32, places: Float32) -> Float32:
        """(Q, D) and (P, D) descriptors -> (Q, P), larger is more alike."""
        ...


@runtime_checkable
class KnowsPlaces(Protocol):
    """A backbone that may have a network of its own which knows places."""

    @property
    def places(self) -> PlaceDescriptor | None:
        """None where there is no such network."""
        ...


class GradientLayout:
    """Histograms of gradient orientation over a lattice of cells, each cell of unit weight."""

    worth_a_look = 0.5

    def describe(self, image: Bytes) -> Float32:
        """(H, W, 3) uint8 BGR -> (ROWS * COLUMNS * BINS,) of unit length, rows first."""
        small = cv2.resize(
            cv2.cvtColor(image, cv2.COLOR_BGR2GRAY),
            (COLUMNS * CELL_PX, ROWS * CELL_PX),
            interpolation=cv2.INTER_AREA,
        )
        x = cv2.Sobel(small, cv2.CV_32F, 1, 0, ksize=3, scale=0.25)
        y = cv2.Sobel(small, cv2.CV_32F, 0, 1, ksize=3, scale=0.25)
        size, angle = cv2.cartToPolar(x, y)
        # a pixel votes for the two orientations beside its own, signs apart
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
        floor = np.sqrt(WEAKEST * CELL_PX**2)
        cells /= np.hypot(np.linalg.norm(cells, axis=1, keepdims=True), floor)
        flat = cells.ravel()
        length = np.linalg.norm(flat)
        unit = flat / length if length > 0 else np.full(len(flat), len(flat) ** -0.5)
        return np.asarray(unit, np.float32)

    def similarity(self, queries: Float32, places: Float32) -> Float32:
        """(Q, D) and (P, D) -> (Q, P): the cosine at the best of a few shifts sideways.

        What all the places share says nothing of which of them it is, and is taken out first.
        """
        a, b = (each.reshape(len(each), ROWS, COLUMNS, BINS) for each in (queries, places))
        return layout_likeness(a, b, SHIFTS)


def layout_likeness(queries: Float32, places: Float32, shifts: Sequence[int]) -> Float32:
    """(Q, rows, columns, D) and (P, rows, columns, D) -> (Q, P): the cosine of what all places do
    not share, at the best of the shifts [columns] sideways."""
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
    """What the loops of a drive look places up by; auto: the backbone's own where it has one.

    Raises ConfigError where a learned one is asked for and there is none.
    """
    own = backbone.places if isinstance(backbone, KnowsPlaces) else None
    if asked == "learned" and own is None:
        raise ConfigError(
            "loops.descriptor=learned: this backbone has no network that knows places; "
            "take auto, or backbone.name=bundle:calm-geo"
        )
    return GradientLayout() if own is None or asked == "gradients" else own


def _unit(cells: Float32) -> Float32:
    rows = cells.reshape(len(cells), -1)
    return np.asarray(rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-9))
