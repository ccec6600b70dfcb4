"""Points of a map as fixed-size records for the viewer: quantised, in random order.

A record has RECORD's 12 bytes, little-endian. A coordinate has BITS bits: the upper 16 are in
`upper`, the lower two in `lower`, x in bits 0 and 1, y in 2 and 3, z in 4 and 5.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calm_edge.types import Bytes, Float, Int

RECORD = np.dtype([("upper", "<u2", 3), ("submap", "<u2"), ("color", "u1", 3), ("lower", "u1")])
BITS = 18
STEPS = (1 << BITS) - 1
MAX_SUBMAPS = 1 << 16
# rows converted at a time, which bounds the memory
_ROWS = 1 << 20


@dataclass(frozen=True, slots=True)
class Box:
    """Cube of the quantisation: its lower corner (3,) and the length of one step."""

    low: Float
    step: float


def random_order(count: int, seed: int = 0) -> Int:
    """Permutation (count,) every prefix of which is a fair sample of all."""
    return np.random.default_rng(seed).permutation(count)


def bounding_box(points: NDArray[np.floating]) -> Box:
    """The smallest cube at the points' lower corner that holds all (P, 3) of them."""
    if not len(points):
        return Box(np.zeros(3), 1.0)
    low, high = (np.asarray(edge, np.float64) for edge in (points.min(0), points.max(0)))
    return Box(low, max(float((high - low).max()), 1e-6) / STEPS)


def packed(points: NDArray[np.floating], color: Bytes, submap: Int, box: Box) -> NDArray[np.void]:
    """Records (P,) of points (P, 3) within the box, colours (P, 3) RGB, and sub-map indices (P,).

    A coordinate is off by at most half a step.
    """
    records = np.empty(len(points), RECORD)
    for first in range(0, len(points), _ROWS):
        rows = slice(first, first + _ROWS)
        steps = (np.asarray(points[rows], np.float64) - box.low) / box.step
        q = np.rint(steps).astype(np.int64).clip(0, STEPS)
        records["upper"][rows] = q >> 2
        records["lower"][rows] = ((q & 3) << [0, 2, 4]).sum(1)
    records["color"], records["submap"] = color, submap
    return records


def unpacked(records: NDArray[np.void], box: Box) -> Float:
    """Points (P, 3) of records, as the viewer places them."""
    low = (records["lower"][:, None].astype(np.int64) >> [0, 2, 4]) & 3
    q = (records["upper"].astype(np.int64) << 2) | low
    return np.asarray(q * box.step + box.low)
