"""Tell a car that stands while others pass from one that drives.

While it drives, what stands still in the picture is its bonnet, and what is very far or straight
ahead, where there is little to follow; while it stands, all is still that no other car covers. What
counts is the part of the picture, not the number of corners: a lorry may have most of these.
"""

from __future__ import annotations

import numpy as np

from calm_edge.types import Float, Float32, Int

# Columns and rows of cells of the picture.
CELLS = (8, 5)
# Distances [share of the long side]: a corner that has moved by less than the first from where the
# shaking car takes it is still; the car shakes by less than the second.
STILL, SHAKE = 0.8 / 640, 2.0 / 640
# Share of the picture that is still from which on the car stands. While it drives it is below 0.15,
# below 0.3 with a bonnet full of texture over a fifth of the picture, and 0.44 where it pulls away.
STANDING = 0.5


def cells(uv: Float32, size: tuple[int, int]) -> Int:
    """Cell (M,) of pixels uv (M, 2) in a picture of size (width, height)."""
    place = np.floor(uv * (np.array(CELLS) / size)).astype(np.int64)
    column, row = np.clip(place, 0, np.array(CELLS) - 1).T
    return np.asarray(row * CELLS[0] + column)


def still_share(detected: Float32, before: Float32, now: Float32, size: tuple[int, int]) -> float:
    """Share of the picture that is still: of cells with corners, the mean of still corners.

    detected: (N, 2) px, all corners of the first picture. before: (M, 2), those that were followed,
    and now: (M, 2) where they are. A corner that was lost is not still. size: width, height.
    """
    every = np.bincount(cells(detected, size), minlength=CELLS[0] * CELLS[1])
    if not every.any():
        return 0.0
    long_side, moved = max(size), np.asarray(now - before, np.float64)
    small = np.linalg.norm(moved, axis=1) < SHAKE * long_side
    if not small.any():
        return 0.0
    shake: Float = np.median(moved[small], axis=0)
    still = np.linalg.norm(moved - shake, axis=1) < STILL * long_side
    kept = np.bincount(cells(before[still], size), minlength=len(every))
    return float((kept[every > 0] / every[every > 0]).mean())
