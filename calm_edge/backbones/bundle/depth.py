"""Dense depth of a solved window: plane sweep, semi-global matching, consistency across views.

The depth D and confidence C of a backbone (paper III). Deterministic; the caller sets the number of
OpenCV's threads.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from calm_edge.backbones.bundle.agreement import Agreement, DepthView, agree
from calm_edge.backbones.bundle.cost_volume import SweepView, match_scores, whitened
from calm_edge.backbones.bundle.other_eye import contradicted, region
from calm_edge.backbones.bundle.scanline import aggregate
from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera
from calm_edge.geometry.flow import long_side
from calm_edge.geometry.undistortion import undistortions
from calm_edge.types import Bytes, Float, Float32, Hints, Int, Prediction

DEPTH_SIDE_PX = 192
OVERSAMPLE = 2
PLANES = 64  # of depth maps of DEPTH_SIDE_PX or more
# The nearest plane has NEAR_SHARE times the depth that NEAR_PERCENT % of the landmarks are below:
# landmarks lie on texture, and the road before the bumper is nearer than any of them.
NEAR_PERCENT = 1.0
NEAR_SHARE = 0.7
NEAREST = 2.0  # smallest depth of a plane, spacings
NEAR_DEFAULT = 5.0  # depth of the nearest plane if there are no landmarks, spacings
# Two views of one camera, or a loop view and another, are matched up to this distance.
REACH = 12.0  # spacings
NEIGHBOURS_A_SIDE = 2
# Tolerance between the inverse depths of two views: a share of the inverse depth, plus a share of
# the step between two planes.
AGREE_RELATIVE = 0.05
AGREE_STEPS = 0.5
SPREAD = 0.05
CONFIDENT = 0.5  # what other views do not agree on needs no contradiction by the other eye
FRINGE_PX = 5  # width of the border around sky where depth is dropped
FARTHEST = 80.0  # spacings: indistinguishable from infinity beyond


def sweep_window(
    images: Sequence[NDArray[np.uint8]],
    hints: Hints,
    prediction: Prediction,
    side_px: int = DEPTH_SIDE_PX,
    every: int = 1,
    reject_moving: bool = True,
) -> tuple[Float32, Float32]:
    """Depth and confidence (N, h, w) of N images (H, W, 3) in batch order.

    Planes are swept over undistorted pictures, 100 degrees across at most, and the result is
    brought back to the pictures as they are: the z-depths of both are the same.

    depth: z in the sub-map's unit, 0 unknown. confidence: [0, 1], about the probability that the
    depth is within five percent. side_px: longer side of the depth maps. every: only every n-th
    view of each camera gets depth, the others 0, but all are matched against. A loop keyframe is
    matched against the nearest views of the window, but none of them against it, as the street may
    have changed; without a pose it gets no depth. reject_moving: drop depth that the other eye
    contradicts.
    """
    if not prediction.loop_found:
        return _without_last(images, hints, prediction, side_px, every, reject_moving)
    eyes = np.asarray(hints.eyes)
    size = _shrunk(images[0], side_px)
    sweep_size = size[0] * OVERSAMPLE, size[1] * OVERSAMPLE
    straight = undistortions(prediction.cameras)
    cameras = [
        lens if s is None else s.camera
        for lens, s in zip(prediction.cameras, straight, strict=True)
    ]
    gray = [np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8) for image in images]
    gray = [g if s is None else s.picture(g) for g, s in zip(gray, straight, strict=True)]
    sweep = [
        SweepView(
            whitened(_shrink(g, sweep_size)),
            _resized(cameras[i], g, sweep_size),
            prediction.T_s_c[i],
        )
        for i, g in enumerate(gray)
    ]
    nearest = nearest_depth(prediction.without_loop() if hints.loop else prediction)
    planes = plane_count(side_px)
    zeta = np.linspace(0, 1 / nearest, planes)
    small = [_shrink(g, size) for g in gray]
    t_ns = np.asarray(hints.t_ns)
    everything = np.arange(len(images))
    kept = depth_views(eyes, hints.loop, every)
    matched, compared = (
        neighbours(among, eyes, t_ns, prediction.T_s_c, hints.loop) for among in (everything, kept)
    )
    views: dict[int, DepthView] = {}
    moving: dict[int, NDArray[np.bool_]] = {}
    step = float(zeta[1] - zeta[0])
    for i in kept.tolist():
        both = reject_moving and eyes[matched[i][:1]].tolist() == [1 - eyes[i]]
        across = np.zeros((planes, size[1], size[0]), np.float32) if both else None
        scores = match_scores(sweep[i], [sweep[j] for j in matched[i]], zeta, size, across)
        camera = _resized(cameras[i], gray[i], size)
        views[i] = DepthView(choose(scores, small[i], zeta), camera, prediction.T_s_c[i])
        if across is not None:
            moving[i] = contradicted(across, views[i].zeta / np.float32(step))
    depth, confidence = np.zeros((2, len(images), size[1], size[0]), np.float32)
    for i, view in views.items():
        others = [views[j] for j in compared[i]]
        parts = judge(agree(view, others, AGREE_RELATIVE, AGREE_STEPS * step))
        if i in moving:
            gone = region(moving[i] & (parts[1] > CONFIDENT))
            parts[0][gone] = parts[1][gone] = 0
        s = straight[i]
        depth[i], confidence[i] = (part if s is None else s.as_taken(part) for part in parts)
    return depth, confidence


def plane_count(side_px: int) -> int:
    """Number of planes for depth maps of a longer side: of smaller ones the step in px is kept."""
    return round(PLANES * min(1.0, side_px / DEPTH_SIDE_PX))


def depth_views(eyes: Int, loop: bool, every: int) -> Int:
    """Indices of every n-th view of each camera, and of a loop view, the last.

    eyes: (N,) of all views.
    """
    window = eyes[: len(eyes) - loop]
    chosen = [np.flatnonzero(window == eye)[::every] for eye in np.unique(window)]
    return np.sort(np.concatenate([*chosen, np.arange(len(window), len(eyes))]))


def neighbours(among: Int, eyes: Int, t_ns: Int, T_s_c: Float, loop: bool) -> dict[int, list[int]]:
    """For each of some views (M,), the others of these that it is matched against.

    eyes, t_ns: (N,), T_s_c: (N, 4, 4) of all views. loop: the last view is a loop view.
    """
    own = among[: len(among) - loop]
    found = {
        int(i): own[sweep_sources(k, eyes[own], t_ns[own], T_s_c[own])].tolist()
        for k, i in enumerate(own)
    }
    if loop:
        found[int(among[-1])] = own[loop_sources(T_s_c[among])].tolist()
    return found


def judge(agreement: Agreement) -> tuple[Float32, Float32]:
    """Depth (h, w) and confidence (h, w) from the views' agreement.

    Depth is 0 where no other view agrees, beyond FARTHEST (sky), and at the sky's border. The
    confidence is n / (n + 1) with n agreeing views, and half of that if their spread is SPREAD
    times the inverse depth.
    """
    zeta, votes = agreement.zeta, agreement.votes
    # foreground fattening: beside a silhouette the sky gets the depth of the foreground
    sky = (zeta <= 1 / FARTHEST).astype(np.uint8)
    fringe = cv2.dilate(sky, np.ones((FRINGE_PX, FRINGE_PX), np.uint8)) > 0
    known = (votes > 0) & ~fringe
    safe = np.where(known, zeta, 1)
    precision = 1 / (1 + (agreement.spread / (SPREAD * safe)) ** 2)
    depth = np.where(known, 1 / safe, 0).astype(np.float32)
    return depth, np.where(known, votes / (votes + 1) * precision, 0).astype(np.float32)


def _shrunk(image: NDArray[np.uint8], side: int) -> tuple[int, int]:
    """Size (w, h) of a picture reduced to `side` px on its long side, with its aspect ratio."""
    scale = min(1.0, side / long_side(image))
    return max(2, round(image.shape[1] * scale)), max(2, round(image.shape[0] * scale))


def _shrink(gray: Bytes, size: tuple[int, int]) -> Bytes:
    return np.asarray(cv2.resize(gray, size, interpolation=cv2.INTER_AREA), np.uint8)


def _resized(camera: Camera, gray: Bytes, size: tuple[int, int]) -> Camera:
    height, width = gray.shape[:2]
    return camera.scaled(size[0] / width, size[1] / height)


def nearest_depth(prediction: Prediction) -> float:
    """Depth of the nearest plane of the sweep, spacings, from the landmarks of all views."""
    marks = prediction.landmarks
    if marks is None or len(marks.index) == 0:
        return NEAR_DEFAULT
    T_c_s = se3.inverse(prediction.T_s_c)[marks.view]
    p_s = marks.points_s[marks.index]
    z = (T_c_s[:, 2, :3] * p_s).sum(1) + T_c_s[:, 2, 3]
    if not np.any(z > 0):
        return NEAR_DEFAULT
    return max(NEAREST, NEAR_SHARE * float(np.percentile(z[z > 0], NEAR_PERCENT)))


def sweep_sources(view: int, eyes: Int, t_ns: Int, T_s_c: Float) -> list[int]:
    """Indices of the views that view `view` is matched against.

    The other camera's nearest in time, and up to NEIGHBOURS_A_SIDE of its own camera on either side
    of it, nearer than REACH. eyes, t_ns: (N,), T_s_c: (N, 4, 4) of all views.
    """
    other = np.flatnonzero(eyes != eyes[view])
    own = np.flatnonzero(eyes == eyes[view])
    out = [int(other[np.argmin(np.abs(t_ns[other] - t_ns[view]))])] if len(other) else []
    for side in (own[own < view][::-1], own[own > view]):
        near = [
            int(j) for j in side if np.linalg.norm(T_s_c[j, :3, 3] - T_s_c[view, :3, 3]) < REACH
        ]
        out += near[:NEIGHBOURS_A_SIDE]
    return out


def loop_sources(T_s_c: Float) -> list[int]:
    """Indices of the views that the loop view, the last of T_s_c (N + 1, 4, 4), is matched against.

    The 2 * NEIGHBOURS_A_SIDE + 1 nearest ones, as far as they are nearer than REACH.
    """
    away = np.linalg.norm(T_s_c[:-1, :3, 3] - T_s_c[-1, :3, 3], axis=1)
    near = np.argsort(away, kind="stable")[: 2 * NEIGHBOURS_A_SIDE + 1]
    return [int(i) for i in near if away[i] < REACH]


def _without_last(
    images: Sequence[NDArray[np.uint8]],
    hints: Hints,
    prediction: Prediction,
    side_px: int,
    every: int,
    reject_moving: bool,
) -> tuple[Float32, Float32]:
    alone, own = prediction.without_loop(), hints.without_loop()
    depth, confidence = sweep_window(images[:-1], own, alone, side_px, every, reject_moving)
    nothing = np.zeros_like(depth[:1])
    return np.concatenate([depth, nothing]), np.concatenate([confidence, nothing])


def choose(scores: Float32, gray: Bytes, zeta: Float) -> Float32:
    """Inverse depth (h, w) from scores (D, h, w) at D planes of inverse depths zeta (D,).

    The plane of least cost after semi-global matching (scanline.py), refined by a parabola through
    its neighbours. gray: (h, w), picture of the view: jumps of depth cost less across its edges.
    """
    cost = aggregate(1 - scores, gray)
    best = np.clip(cost.argmin(0), 1, len(zeta) - 2)
    before, there, after = (np.take_along_axis(cost, (best + k)[None], 0)[0] for k in (-1, 0, 1))
    bend = before - 2 * there + after
    shift = np.where(bend > 1e-6, (before - after) / (2 * np.maximum(bend, 1e-6)), 0)
    place = best + np.clip(shift, -1, 1)
    return np.asarray(place * (zeta[1] - zeta[0]), np.float32)
