"""Mask of what is attached to the car in a camera's picture, learned over the drive.

Bonnet, dashboard, their reflections, burnt-in clocks and black bars. The picture is divided into
cells, each with the log odds that what it shows is attached to the car.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calm_edge.geometry.picture_mask import grid
from calm_edge.types import Bytes, Float, Float32

Bool = NDArray[np.bool_]

# Cells along the long side.
CELLS = 32
# Share of a cell's points that do not follow the scene: where it shows the car, and else (wrong
# matches and traffic). On drives with a bonnet 0.93 and 0.05; both are taken for nearer to even.
ATTACHED_SHARE, SCENE_SHARE = 0.7, 0.15
# Most log odds that one window gives a cell: its points share their errors, and a lorry stays for
# some windows. A cell that is certain can change its mind within this many windows.
WINDOW_LOG_ODDS, MOST_WINDOWS = 1.5, 6
# A cell is masked from these log odds on: those of three windows at least.
MASKED_LOG_ODDS = 4.0
# Weight of the four neighbours' mean, so that a region with few points is decided as one.
NEIGHBOURS = 1.0
# A mask of a larger share of the picture is not used: more than bonnets and dashboards hide.
MAX_SHARE = 0.4
# Least number of cells of a region.
MIN_CELLS = 2
# Share of the log odds that is left for the next drive: cameras are moved between drives.
REMEMBERED = 0.6


def shape_for(width: int, height: int) -> tuple[int, int]:
    """Rows and columns of the cells of a picture [px]."""
    return grid(width, height, CELLS)


@dataclass(frozen=True, slots=True)
class Evidence:
    """Numbers of points of a window, by cells (rows, columns).

    fails: that do not follow the scene. follows: that do. still: those of `fails` that stand still
    in the picture.
    """

    fails: Float
    follows: Float
    still: Float

    @classmethod
    def of_points(
        cls, uv: Float32, fails: Bool, follows: Bool, still: Bool, size: tuple[int, int]
    ) -> Evidence:
        """Count points uv (N, 2) px of a picture of size (width, height)."""
        shape = shape_for(*size)
        cell = np.floor((uv + 0.5) * (np.array(shape[::-1]) / np.array(size))).astype(np.int64)
        column, row = np.clip(cell, 0, np.array(shape[::-1]) - 1).T
        counts = np.zeros((3, *shape))
        for count, kind in zip(counts, (fails, follows, fails & still), strict=True):
            np.add.at(count, (row[kind], column[kind]), 1.0)
        return cls(*counts)

    @classmethod
    def summed(cls, parts: Sequence[Evidence]) -> Evidence:
        """The points of all pairs of pictures."""
        columns = zip(*((p.fails, p.follows, p.still) for p in parts), strict=True)
        return cls(*(np.sum(column, axis=0) for column in columns))

    def log_odds(self) -> tuple[Float, Float]:
        """Log odds (rows, columns) that a cell is attached to the car: of all points, of still."""
        more = np.log(ATTACHED_SHARE / SCENE_SHARE)
        less = np.log((1 - ATTACHED_SHARE) / (1 - SCENE_SHARE))
        limits = -WINDOW_LOG_ODDS, WINDOW_LOG_ODDS
        return (
            np.clip(more * self.fails + less * self.follows, *limits),
            np.clip(more * self.still + less * self.follows, *limits),
        )


class EgoMask:
    """Mask of one eye. log_odds: (2, rows, columns), of all points and of those that stand still.

    A region at the picture's border is masked by all its points; one amid the picture, such as a
    clock, only by points that stand still: else it may be a place where matching often fails.
    """

    def __init__(self, log_odds: Float | None = None) -> None:
        self.log_odds = log_odds

    def add(self, evidence: Evidence) -> None:
        """Add a window's evidence; pictures of another size begin anew."""
        new = np.stack(evidence.log_odds())
        if self.log_odds is None or self.log_odds.shape != new.shape:
            self.log_odds = np.zeros_like(new)
        limit = WINDOW_LOG_ODDS * MOST_WINDOWS
        self.log_odds = np.clip(self.log_odds + new, -limit, limit)

    @property
    def cells(self) -> Bytes | None:
        """Masked cells (rows, columns) uint8, 1 where masked; None if there are none."""
        if self.log_odds is None:
            return None
        found = _regions(self.log_odds)
        return found.astype(np.uint8) if 0 < found.mean() <= MAX_SHARE else None

    @property
    def too_large(self) -> bool:
        """Whether there is a mask that is not used because of its size."""
        return self.log_odds is not None and bool(_regions(self.log_odds).mean() > MAX_SHARE)


def remembered(log_odds: Float) -> Float:
    """Log odds to begin the next drive with."""
    return np.asarray(REMEMBERED * log_odds)


def _regions(log_odds: Float) -> Bool:
    of_all, of_still = (_with_neighbours(each) > MASKED_LOG_ODDS for each in log_odds)
    masked = np.zeros_like(of_all)
    for region in _connected(of_all):
        if region.sum() >= MIN_CELLS and _at_border(region):
            masked |= region
    for region in _connected(of_still & ~masked):
        if region.sum() >= MIN_CELLS:
            masked |= region
    return _filled(masked, log_odds[0])


def _with_neighbours(log_odds: Float) -> Float:
    padded = np.pad(log_odds, 1, mode="edge")
    sides = padded[:-2, 1:-1] + padded[2:, 1:-1] + padded[1:-1, :-2] + padded[1:-1, 2:]
    return np.asarray(log_odds + NEIGHBOURS * sides / 4)


def _connected(mask: Bool) -> list[Bool]:
    """Regions that are connected by the sides of cells, largest first."""
    count, label = cv2.connectedComponents(mask.astype(np.uint8), connectivity=4)
    found = [np.asarray(label == k) for k in range(1, count)]
    return sorted(found, key=lambda region: -int(region.sum()))


def _at_border(region: Bool) -> bool:
    edges = region[0], region[-1], region[:, 0], region[:, -1]
    return any(bool(edge.any()) for edge in edges)


def _filled(masked: Bool, log_odds: Float) -> Bool:
    """Add what the mask encloses, alone or with the border, without much evidence against it."""
    out = masked.copy()
    for region in _connected(~masked)[1:]:
        if log_odds[region].mean() > -WINDOW_LOG_ODDS / 2:
            out |= region
    return out
