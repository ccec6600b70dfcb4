"""Pose of a batch's loop keyframe, an earlier picture, by resection (paper IV-D).

The window is solved without it, so that a wrong one cannot distort it. Its features are then
matched to a few views of the window, triangulated by the solved poses, and the picture's pose is
found from those points. They stay landmarks, so that a later solution can place it again without
the picture.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from calm_edge.backbones.bundle.initialise import resection
from calm_edge.geometry import pnp, se3, sift
from calm_edge.geometry.camera import Camera, back_project_each, project_each
from calm_edge.geometry.flow import long_side
from calm_edge.geometry.triangulation import triangulate
from calm_edge.loops.descriptor import GradientLayout
from calm_edge.loops.same_place import EPIPOLAR_PX, POSE_PX, REFERENCE_SIDE_PX
from calm_edge.types import Float, Float32, Hints, Int, Landmarks, Prediction

MAX_FEATURES = 800
VIEWS_A_SIDE = 2  # primary views matched before and after the most similar one
POINT_PX = 2.0  # largest reprojection error, in a picture of REFERENCE_SIDE_PX
MIN_INLIERS = 20
MIN_INLIER_SHARE = 0.5
MAX_SIGMA = 0.3  # largest sigma of the loop view's position, spacings


@dataclass(frozen=True, slots=True)
class LoopTracks:
    """Matches of L points of the loop picture in views of the window, O observations in all.

    point: (O,) index of the point. view: (O,) batch index. uv: (O, 2) px in that view. loop_uv: (L,
    2) px in the loop picture.
    """

    point: Int
    view: Int
    uv: Float
    loop_uv: Float


@dataclass(frozen=True, slots=True)
class LoopPose:
    """Pose of the loop view, and the points that determine it.

    T_s_c: (4, 4) of the loop view. points_s: (L, 3), NaN if unknown. inlier: (L,) bool, points
    that fit the pose. kept: (O,) bool, observations in the window that fit their point.
    """

    T_s_c: Float
    points_s: Float
    inlier: NDArray[np.bool_]
    kept: NDArray[np.bool_]


def with_loop(
    images: Sequence[NDArray[np.uint8]], hints: Hints, prediction: Prediction
) -> Prediction:
    """The window's prediction (N views) with the loop view as the last of N + 1.

    images: (H, W, 3) uint8 BGR, N + 1. `loop_found` is False where it could not be placed.
    """
    tracks = match_loop(images, hints, prediction.cameras)
    pose = locate(prediction.cameras, prediction.T_s_c, tracks)
    if pose is None:
        return _appended(prediction, np.eye(4), prediction.landmarks, found=False)
    assert prediction.landmarks is not None
    marks = _with_tracks(prediction.landmarks, tracks, pose, len(images) - 1)
    return _appended(prediction, pose.T_s_c, marks, found=True)


def placed_again(window: Prediction, earlier: Prediction) -> Prediction:
    """Add the loop view to `window`, which was solved again without it.

    earlier: prediction of the same batch with the loop view. From its landmarks the pose is found
    again; where they no longer give one, the loop view keeps its pose relative to the nearest view.
    """
    marks, n = earlier.landmarks, len(window.cameras)
    if not earlier.loop_found or marks is None or window.landmarks is None:
        return _appended(window, np.eye(4), window.landmarks, found=False)
    of_loop = marks.seen_by(n)
    rows = np.isin(marks.index, of_loop)
    point = np.searchsorted(of_loop, marks.index[rows])
    view, uv = marks.view[rows], marks.uv[rows].astype(np.float64)
    loop_uv = np.zeros((len(of_loop), 2))
    loop_uv[point[view == n]] = uv[view == n]
    own = view < n
    tracks = LoopTracks(point[own], view[own], uv[own], loop_uv)
    pose = locate(window.cameras, window.T_s_c, tracks)
    if pose is not None:
        together = _with_tracks(window.landmarks, tracks, pose, n)
        return _appended(window, pose.T_s_c, together, found=True)
    away = np.linalg.norm(earlier.T_s_c[:-1, :3, 3] - earlier.T_s_c[-1, :3, 3], axis=1)
    nearest = int(np.argmin(away))
    T_view_loop = se3.inverse(earlier.T_s_c[nearest]) @ earlier.T_s_c[-1]
    return _appended(window, window.T_s_c[nearest] @ T_view_loop, window.landmarks, found=True)


def match_loop(
    images: Sequence[NDArray[np.uint8]],
    hints: Hints,
    cameras: Sequence[Camera],
    loop_camera: Camera | None = None,
) -> LoopTracks:
    """Match SIFT features of the loop picture, the last one, to the views most similar to it.

    cameras: of the views. loop_camera: of the loop picture, None: that of the first view. Only
    points that are matched in two views or more are kept.
    """
    loop = sift.detect(_gray(images[-1]), MAX_FEATURES)
    own = loop_camera or cameras[0]
    stretch = long_side(images[-1]) / REFERENCE_SIDE_PX
    row, view, uv = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)], [np.zeros((0, 2), np.float32)]
    for v in _alike(images, hints):
        there = sift.detect(_gray(images[v]), MAX_FEATURES)
        pairs = sift.consistent(loop, there, EPIPOLAR_PX * stretch, (own, cameras[v]))
        row.append(pairs[:, 0])
        view.append(np.full(len(pairs), v))
        uv.append(there.uv[pairs[:, 1]])
    rows = np.concatenate(row)
    seen, point = np.unique(rows, return_inverse=True)
    twice = (np.bincount(point, minlength=len(seen)) >= 2)[point]
    kept, point = np.unique(point[twice], return_inverse=True)
    return LoopTracks(
        point,
        np.concatenate(view)[twice],
        np.concatenate(uv)[twice].astype(np.float64),
        loop.uv[seen[kept]].astype(np.float64),
    )


def locate(
    cameras: Sequence[Camera],
    T_s_c: Float,
    tracks: LoopTracks,
    loop_camera: Camera | None = None,
) -> LoopPose | None:
    """The loop view's pose from its tracks; None with too few inliers or too large a sigma.

    cameras: N, T_s_c: (N, 4, 4) of the window. loop_camera: as of `match_loop`.
    """
    n_points = len(tracks.loop_uv)
    if n_points < MIN_INLIERS:
        return None
    camera = loop_camera or cameras[0]
    size = 2 * np.array([camera.cx, camera.cy]) + 1
    stretch = float(max(size)) / REFERENCE_SIDE_PX
    points, kept = _points(cameras, T_s_c, tracks, POINT_PX * stretch)
    (known,) = np.nonzero(np.isfinite(points[:, 0]))
    rays = camera.normalized(tracks.loop_uv)
    try:
        guess = resection(points[known], rays[known], camera.fx, None)
    except cv2.error:  # raised if no sample gives a model
        return None
    if guess is None:
        return None
    seen = tracks.loop_uv[known].astype(np.float32)
    fit = pnp.refine(camera, points[known], seen, se3.inverse(guess), POSE_PX * stretch)
    if fit is None or fit.n_inliers < max(MIN_INLIERS, MIN_INLIER_SHARE * len(known)):
        return None
    sigma = float(np.sqrt(np.linalg.eigvalsh(fit.covariance[:3, :3])[-1]))
    if sigma > MAX_SIGMA or not sift.well_spread(seen[fit.inlier], size):
        return None
    inlier = np.zeros(n_points, bool)
    inlier[known[fit.inlier]] = True
    return LoopPose(fit.T_w_c, points, inlier, kept)


def _points(
    cameras: Sequence[Camera], T_s_c: Float, tracks: LoopTracks, threshold_px: float
) -> tuple[Float, NDArray[np.bool_]]:
    """Points (L, 3), NaN with fewer than two inlier views, and the inlier observations (O,).

    Triangulated, sub-map frame. threshold_px: largest reprojection error of an inlier.
    """
    T_c_s, n_points = se3.inverse(T_s_c), len(tracks.loop_uv)
    depth = np.ones(len(tracks.uv))
    rays = back_project_each(cameras, tracks.view, tracks.uv, depth)[:, :2]
    kept = np.ones(len(tracks.view), bool)
    for _ in range(2):  # the second time without outliers
        X = triangulate(T_c_s, tracks.view[kept], tracks.point[kept], rays[kept], n_points)
        finite = X[:, 3] > 1e-6 * np.linalg.norm(X[:, :3], axis=1)
        points = np.where(finite[:, None], X[:, :3] / np.where(finite, X[:, 3], 1)[:, None], np.nan)
        T = T_c_s[tracks.view]
        p_c = (T[:, :3, :3] @ points[tracks.point][..., None])[..., 0] + T[:, :3, 3]
        miss = np.linalg.norm(project_each(cameras, tracks.view, p_c) - tracks.uv, axis=1)
        kept = (p_c[:, 2] > 0) & (miss < threshold_px)
    points[np.bincount(tracks.point[kept], minlength=n_points) < 2] = np.nan
    return points, kept


def _alike(images: Sequence[NDArray[np.uint8]], hints: Hints) -> list[int]:
    """Batch indices: the primary view most similar to the last picture, those around it, and the
    assistant's at its time."""
    layout, eyes, t_ns = GradientLayout(), np.asarray(hints.eyes)[:-1], hints.t_ns[:-1]
    primary, assistant = np.flatnonzero(eyes == 0), np.flatnonzero(eyes == 1)
    described = np.stack([layout.describe(images[int(v)]) for v in primary])
    likeness = layout.similarity(layout.describe(images[-1])[None], described)[0]
    best = int(likeness.argmax())
    own = primary[max(0, best - VIEWS_A_SIDE) : best + VIEWS_A_SIDE + 1]
    partner = int(assistant[np.argmin(np.abs(t_ns[assistant] - t_ns[primary[best]]))])
    return [*own.tolist(), partner]


def _gray(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)


def _with_tracks(marks: Landmarks, tracks: LoopTracks, pose: LoopPose, loop_view: int) -> Landmarks:
    """Add to the landmarks the inlier points, observed in the window and in the loop view."""
    (chosen,) = np.nonzero(pose.inlier)
    number = np.full(len(pose.inlier), -1)
    number[chosen] = len(marks.points_s) + np.arange(len(chosen))
    rows = pose.kept & pose.inlier[tracks.point]
    uv: list[Float | Float32] = [marks.uv, tracks.uv[rows], tracks.loop_uv[chosen]]
    sigma, edge = marks.sigma_px, marks.edge
    added = int(rows.sum()) + len(chosen)
    if sigma is not None:
        sigma = np.concatenate([sigma, np.full(added, EPIPOLAR_PX, np.float32)])
    if edge is not None:
        edge = np.concatenate([edge, np.zeros((added, 2), np.float32)])
    return Landmarks(
        np.concatenate([marks.points_s, pose.points_s[chosen]]),
        np.concatenate([marks.index, number[tracks.point[rows]], number[chosen]]),
        np.concatenate([marks.view, tracks.view[rows], np.full(len(chosen), loop_view)]),
        np.concatenate(uv).astype(np.float32),
        sigma,
        edge,
    )


def _appended(
    window: Prediction, T_s_loop: Float, marks: Landmarks | None, *, found: bool
) -> Prediction:
    sigma = window.focal_log_sigma
    return replace(
        window,
        cameras=(*window.cameras, window.cameras[0]),
        T_s_c=np.concatenate([window.T_s_c, T_s_loop[None]]),
        focal_log_sigma=None if sigma is None else np.append(sigma, sigma[0]),
        landmarks=marks,
        loop_found=found,
    )
