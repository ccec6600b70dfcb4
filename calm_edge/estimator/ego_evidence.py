"""Test points of a solved window for following the scene's geometry, to find what does not.

Bonnet, dashboard, their reflections, burnt-in clocks and dirt on the lens are attached to the car.
Corners are followed between neighbouring keyframes of one camera and compared with the motion of a
scene that stands still. It needs no depth: seen from a moving camera, a point moves from where a
far one would be straight away from the direction of travel (Hartley and Zisserman, Multiple View
Geometry, 11.7). What stands still in the picture fails that in every turn, reflections always.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera
from calm_edge.geometry.flow import Gray, corners, follow, long_side, neighbouring_flow
from calm_edge.kit.ego_mask import Evidence
from calm_edge.types import Bytes, Float, Float32, Int

Bool = NDArray[np.bool_]

# Pairs of keyframes a window and camera that are tested, spread over the window.
PAIRS = 2
# Corners wanted in each tile of the picture (rows, columns): on a bonnet they are faint.
TILES, CORNERS = (4, 4), 35
# Distance [share of the long side] beyond which a point does not follow the scene; a point that
# follows it counts only if it has moved by as much, as else it may stand still in the picture.
TOLERANCE = 0.005
# A pair counts if the picture moves by at least this share of the long side (median), and if this
# share of the points that decide follow the scene, and so many: else the poses may be wrong.
FLOWING, SOUND, MIN_FOLLOW = 0.006, 0.6, 20
# Length of the step [rad] by which the direction of a point's motion is computed.
_STEP = 1e-3


def of_window(
    images: Sequence[Bytes], eyes: Int, cameras: Sequence[Camera], T_s_c: Float
) -> tuple[Evidence | None, Evidence | None]:
    """Evidence of a window on the mask of each eye; None if no pair of its keyframes counts.

    images: N (H, W, 3), of which the first eyes (M,) are those of the window, M <= N. cameras: of
    each eye. T_s_c: (N, 4, 4).
    """
    found: list[Evidence | None] = []
    for eye, camera in enumerate(cameras):
        parts = []
        for a, b in _pairs(np.flatnonzero(eyes == eye).tolist()):
            grays = [
                np.asarray(cv2.cvtColor(images[i], cv2.COLOR_BGR2GRAY), np.uint8) for i in (a, b)
            ]
            T_b_a = np.asarray(se3.inverse(T_s_c[b]) @ T_s_c[a])
            part = of_pair(grays[0], grays[1], camera, T_b_a)
            parts += [] if part is None else [part]
        found.append(Evidence.summed(parts) if parts else None)
    return found[0], found[1]


def _pairs(views: list[int]) -> list[tuple[int, int]]:
    """At most PAIRS pairs of neighbouring views, spread over all."""
    pairs = list(pairwise(views))
    chosen = {(2 * k + 1) * len(pairs) // (2 * PAIRS) for k in range(PAIRS)} if pairs else set()
    return [pairs[k] for k in sorted(chosen)]


def of_pair(a: Gray, b: Gray, camera: Camera, T_b_a: Float) -> Evidence | None:
    """Evidence of two pictures of a camera, T_b_a (4, 4) apart; None if they do not count."""
    uv = _spread_corners(a)
    moved, ok = follow(a, b, uv)
    uv, moved = uv[ok], moved[ok]
    tolerance = TOLERANCE * long_side(a)
    flow = np.linalg.norm(moved - uv, axis=1)
    if not len(uv) or np.median(flow) < FLOWING * long_side(a):
        return None
    off = scene_residual(uv, moved, camera, T_b_a)
    follows, fails = (off < tolerance / 2) & (flow > tolerance), off > tolerance
    if follows.sum() < max(MIN_FOLLOW, SOUND * (fails | follows).sum()):
        return None
    fails &= ~_would_follow(a, b, uv, moved - uv, (follows, fails), camera, T_b_a)
    size = a.shape[1], a.shape[0]
    return Evidence.of_points(uv, fails, follows, flow < tolerance / 2, size)


def _spread_corners(gray: Gray) -> Float32:
    """Corners (N, 2) px, the strongest of each tile."""
    height, width = gray.shape
    rows, columns = TILES
    found = []
    for r, c in np.ndindex(rows, columns):
        top, left = r * height // rows, c * width // columns
        tile = gray[top : (r + 1) * height // rows, left : (c + 1) * width // columns]
        found.append(corners(tile, CORNERS) + np.array([left, top], np.float32))
    return np.concatenate(found)


def _would_follow(
    a: Gray,
    b: Gray,
    uv: Float32,
    flow: Float32,
    kinds: tuple[Bool, Bool],
    camera: Camera,
    T_b_a: Float,
) -> Bool:
    """Which points (N,) that failed follow the scene if they are started from neighbours that do.

    Those may be on a repeated pattern, such as a dashed line. kinds: that follow, that fail.
    """
    follows, fails = kinds
    again = np.flatnonzero(fails)
    would = np.zeros(len(uv), bool)
    if not len(again):
        return would
    guess = uv + neighbouring_flow(uv, flow, follows)
    moved, ok = follow(a, b, uv[again], guess[again])
    off = scene_residual(uv[again], moved, camera, T_b_a)
    would[again] = ok & (off < TOLERANCE * long_side(a))
    return would


def scene_residual(uv: Float32, moved: Float32, camera: Camera, T_b_a: Float) -> Float:
    """Distance [px] of matches from what a scene that stands still allows, (N,); NaN if unseen.

    uv, moved: (N, 2) px. The allowed places are those of depths from infinity to nearby: a curve,
    which is taken for straight between infinity and the match.
    """
    rays = camera.rays(uv.astype(np.float64)) @ T_b_a[:3, :3].T
    t = T_b_a[:3, 3]
    length = np.linalg.norm(t)
    far = camera.project(rays)
    if length < 1e-9:
        off = np.linalg.norm(moved - far, axis=1)
    else:
        # the direction in which a point moves when it comes nearer
        near = camera.project(rays + _STEP * t / length)
        ahead = near - far
        ahead /= np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-12)
        step = moved - far
        along = np.maximum((step * ahead).sum(1), 0.0)
        off = np.linalg.norm(step - along[:, None] * ahead, axis=1)
    return np.asarray(np.where(np.isfinite(off), off, np.nan))
