"""Motion of the car along the road, from pictures of the road seen from above.

Seen so, the road only turns and shifts between two pictures. The turn is known, so the shift is
where a patch of one picture correlates best with the next (matchTemplate), as a computer mouse
measures its motion. A whole window's shifts are chosen together, so that the speed is steady.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from calm_edge.geometry.camera import Camera
from calm_edge.geometry.flow import Gray
from calm_edge.types import Float, Float32, Int

# Cells, in heights of the camera above the road; range ahead and to either side. The part of one
# picture from SOUGHT_FROM on is sought in the next.
CELL, NEAREST, FARTHEST, BESIDE = 0.1, 1.6, 11.0, 2.6
SOUGHT_FROM, SOUGHT_BESIDE = 5.5, 1.8
# What is along the road, such as its markings, shows no motion: the mean over so many cells ahead
# is taken out, and contrast evened. NOISE: contrast of mere noise, in grey levels.
EVENED_CELLS, NOISE, BLUR_PX = 9, 2.0, 0.7
# Cost of a change of the log speed within a second, as a correlation, by its square.
STEADY = 0.5
# Least mean correlation of the steps; of a road without texture it is 0.15.
FOUND = 0.25
# A pattern that repeats, such as a kerb's, correlates at several speeds: the correlation at those
# that differ by more than this in log, and by OTHER_CELLS a step, must be below this share.
OTHER_SPEED, OTHER_CELLS, MOST_ALIKE = 0.25, 3, 0.75


def motion(
    pictures: Sequence[Gray], turn: Float, t: Float, camera: Camera, normal: Float, ahead: Float
) -> Float | None:
    """Motion (S, 3) along the road between S + 1 pictures, each in the axes of the first of two.

    turn: (S, 3, 3) from a view's axes to the next one's. t: (S + 1,) seconds. normal: of the road,
    over its distance. None if the pictures do not show it.
    """
    height = 1 / np.linalg.norm(normal)
    down = normal * height
    along = ahead - down * (down @ ahead)
    along /= np.linalg.norm(along)
    beside = np.cross(down, along)
    z, x = np.arange(NEAREST, FARTHEST, CELL), np.arange(-BESIDE, BESIDE, CELL)
    ground = height * (down + z[:, None, None] * along + x[:, None] * beside)
    first = round((SOUGHT_FROM - NEAREST) / CELL), round((BESIDE - SOUGHT_BESIDE) / CELL)
    smooth = [cv2.GaussianBlur(each.astype(np.float32), (0, 0), BLUR_PX) for each in pictures]
    scores = []
    for a, b, R in zip(smooth[:-1], smooth[1:], turn, strict=True):
        sought = _evened(a, camera, ground)[first[0] :, first[1] : -first[1]]
        there = _evened(b, camera, ground @ R.T)
        scores.append(cv2.matchTemplate(there, sought, cv2.TM_CCORR_NORMED)[: first[0] + 1])
    # the other way round, row i is of a road that has come i cells nearer
    found = _chosen(np.nan_to_num(np.array(scores, np.float64))[:, ::-1], np.diff(t))
    if found is None:
        return None
    nearer, side = found
    moved = nearer[:, None] * along + (first[1] - side)[:, None] * beside
    return np.asarray(moved * CELL * height)


def _chosen(score: Float, seconds: Float) -> tuple[Int, Int] | None:
    """Rows (S,) and columns (S,) of the shifts, by their scores (S, K, L); None if not clear.

    Row k: k cells nearer. seconds: (S,) of the steps.
    """
    steps, cells = np.arange(len(score)), np.arange(score.shape[1])
    speed, highest = np.log(np.maximum(cells, 0.5) / seconds[:, None]), score.max(2)
    best = _steadiest(highest, speed, seconds)
    other = np.abs(speed - speed[steps, best][:, None]) > OTHER_SPEED
    other &= np.abs(cells - best[:, None]) > OTHER_CELLS
    elsewhere = np.where(other, highest, 0.0)
    rival = elsewhere[steps, _steadiest(elsewhere, speed, seconds)]
    chosen = highest[steps, best]
    if chosen.mean() < FOUND or rival.sum() > MOST_ALIKE * chosen.sum():
        return None
    return best, score[steps, best].argmax(1)


def _steadiest(score: Float, speed: Float, seconds: Float) -> Int:
    """Indices (S,) of the speeds of most correlation that change least, by dynamic programming.

    score, speed: (S, K) correlation and log speed of each step and candidate.
    """
    total, came = score[0], []
    for k in range(1, len(score)):
        apart = (seconds[k] + seconds[k - 1]) / 2
        rate = (speed[k][:, None] - speed[k - 1]) / apart
        from_each = total - STEADY * apart * rate**2
        came.append(from_each.argmax(1))
        total = score[k] + from_each.max(1)
    path = [int(total.argmax())]
    for back in reversed(came):
        path.append(int(back[path[-1]]))
    return np.array(path[::-1])


def _evened(picture: NDArray[Any], camera: Camera, ground: Float) -> Float32:
    """A picture seen at points of the ground (Z, X, 3), camera axes, without what is along it."""
    uv = camera.project(ground.reshape(-1, 3))
    inside = camera.within_reach(ground.reshape(-1, 3))
    inside &= (uv > 1).all(1) & (uv < [camera.width - 2, camera.height - 2]).all(1)
    at = np.where(inside[:, None], uv, -9).astype(np.float32).reshape(*ground.shape[:2], 2)
    seen = inside.reshape(ground.shape[:2]).astype(np.float32)

    def mean(values: Float32, sides: tuple[int, int]) -> Float32:
        total = cv2.boxFilter(values, -1, sides, normalize=False)
        return np.asarray(total / np.maximum(cv2.boxFilter(seen, -1, sides, normalize=False), 1))

    own = cv2.remap(picture, at[..., 0], at[..., 1], cv2.INTER_LINEAR) * seen
    own = (own - mean(own, (1, EVENED_CELLS))) * seen
    contrast = mean(own * own, (EVENED_CELLS, EVENED_CELLS)) + NOISE**2
    return np.asarray(own / np.sqrt(contrast), np.float32)
