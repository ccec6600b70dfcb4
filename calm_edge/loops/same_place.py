"""Verify that an earlier image shows the place that both cameras see now (paper IV-D).

Enough matches on one epipolar geometry are not sufficient: a far ridge or repeated facades have
them too. So points are triangulated between the two cameras; one pose of the earlier image has to
explain the near ones and the remaining matches; and most of the points, matched or not, must be
found in the earlier image where that pose projects them.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.optimize import least_squares

from calm_edge.geometry import epipolar, pnp, se3
from calm_edge.geometry.camera import Camera
from calm_edge.geometry.sift import Features, cells, consistent, well_spread
from calm_edge.geometry.triangulation import triangulate
from calm_edge.types import Float, Float32, Int

REFERENCE_SIDE_PX = 640  # thresholds in px are for this long side and scale with it
EPIPOLAR_PX = 1.0
POSE_PX = 3.0
# Sigma of the motion between the exposures of the two cameras, tens of milliseconds apart:
# mostly forward, with little rotation. Spacings (x, y, z), then rad.
RIG_SIGMA = np.array([0.1, 0.1, 0.5, 0.01, 0.01, 0.01])
# A point is near if its parallax between the cameras exceeds the FAR_PERCENT percentile, that of
# the farthest points, by this.
NEAR_PX = 2.0
FAR_PERCENT = 10.0
SOME_DEPTH = 10.0  # spacings; for the direction of the parallax any depth will do
MIN_AGREEING = 0.6
# A point is found again by a feature within this distance [px] of its projection, with at least
# this cosine similarity of descriptors. MIN_SEEN_AGAIN: share of points required for one place.
SEEN_AGAIN_PX = 8.0
SEEN_AGAIN_SIMILARITY = 0.8
MIN_SEEN_AGAIN = 0.5
# largest relative pose of the two images: spacings, and rad
MAX_DISTANCE = 40.0
MAX_ANGLE_RAD = np.radians(60.0)


@dataclass(frozen=True, slots=True)
class KnownKit:
    """Current estimate of the kit. T_p_a: (4, 4); the length of its translation is not used."""

    cameras: tuple[Camera, Camera]
    T_p_a: Float


@dataclass(frozen=True, slots=True)
class SamePlace:
    """Pose of an earlier image that explains its matches.

    T_query_match: (4, 4) match->query, approximate, spacings. seen_again: share of the current
    points that are found in the earlier image.
    """

    T_query_match: Float
    seen_again: float

    @property
    def is_same(self) -> bool:
        """Whether the earlier image shows the same place, not only a similar one."""
        return self.seen_again >= MIN_SEEN_AGAIN


def same_place(
    query: Features,
    assistant: Features,
    past: Features,
    kit: KnownKit,
    size: Int,
    min_matches: int,
    past_camera: Camera | None = None,
) -> SamePlace | None:
    """Compare an earlier image with a primary image and an assistant image of the same time.

    size: (2,) width, height [px] of primary images. past_camera: of the earlier image; None: the
    primary. min_matches: required number of epipolar
    inliers with the earlier image; a third of it is required of near points. None if no pose
    explains the matches.
    """
    stretch = float(max(size)) / REFERENCE_SIDE_PX
    primary = kit.cameras[0]
    earlier = past_camera or primary
    pairs = consistent(query, past, EPIPOLAR_PX * stretch, (primary, earlier))
    if len(pairs) < min_matches or not well_spread(query.uv[pairs[:, 0]], size):
        return None
    across = consistent(query, assistant, EPIPOLAR_PX * stretch, kit.cameras)
    shared, in_past, in_assistant = np.intersect1d(
        pairs[:, 0], across[:, 0], assume_unique=True, return_indices=True
    )
    if len(shared) < min_matches // 3:
        return None
    uv_q, uv_a = _double(query, across[:, 0]), _double(assistant, across[:, 1])
    all_points, all_near = triangulated(uv_q, uv_a, kit, rig_between(uv_q, uv_a, kit))
    points, near = all_points[in_assistant], all_near[in_assistant]
    uv_past = past.uv[pairs[in_past, 1]]
    fit = _pose(earlier, points[near], uv_past[near], POSE_PX * stretch)
    if fit is None or fit.n_inliers < max(min_matches // 3, MIN_AGREEING * near.sum()):
        return None
    if not well_spread(query.uv[shared[near][fit.inlier]], size):
        return None
    T = fit.T_w_c
    if (
        np.linalg.norm(T[:3, 3]) > MAX_DISTANCE
        or np.linalg.norm(se3.so3_log(T[:3, :3])) > MAX_ANGLE_RAD
    ):
        return None
    F = epipolar.from_motion(primary, earlier, se3.inverse(T))
    straight = [
        camera.undistorted(_double(features, rows))
        for camera, features, rows in ((primary, query, pairs[:, 0]), (earlier, past, pairs[:, 1]))
    ]
    miss = np.abs(epipolar.sampson(F, *straight))
    if np.mean(miss < POSE_PX * stretch) < MIN_AGREEING:
        return None
    cameras = primary, earlier
    again = seen_again(all_points, query.vector[across[:, 0]], past, cameras, T, size)
    return SamePlace(T, again)


def seen_again(
    points: Float,
    vectors: Float32,
    past: Features,
    cameras: tuple[Camera, Camera],
    T_q_past: Float,
    size: Int,
) -> float:
    """Share of points (M, 3) found in the earlier image at their projection by T_q_past (4, 4).

    points: in the query camera, with descriptors `vectors` (M, 128). cameras: of
    the query and of the earlier image. size: (2,) width, height px.
    Cells of the query image are weighted equally, so that a richly textured object does not decide.
    """
    p = se3.transform(se3.inverse(T_q_past), points)
    front = (points[:, 2] > 0) & (p[:, 2] > 0)
    if not front.any() or len(past.uv) == 0:
        return 0.0
    uv = cameras[1].project(p[front])
    similarity = vectors[front] @ past.vector.T
    away = np.linalg.norm(uv[:, None] - past.uv[None], axis=2)
    away /= float(max(size)) / REFERENCE_SIDE_PX
    there = ((similarity > SEEN_AGAIN_SIMILARITY) & (away < SEEN_AGAIN_PX)).any(1)
    _, cell = np.unique(cells(cameras[0].project(points[front]), size), return_inverse=True)
    return float((np.bincount(cell, there) / np.bincount(cell)).mean())


def rig_between(uv_p: Float, uv_a: Float, kit: KnownKit) -> Float:
    """Relative pose T_a_p (4, 4), spacings, of a primary and an assistant image.

    Estimated from their matches (M, 2) px, with the rig as prior: it differs from the rig because
    the car moves between the two exposures.
    """
    T_p_a = np.array(kit.T_p_a)
    T_p_a[:3, 3] /= np.linalg.norm(T_p_a[:3, 3])
    start = se3.inverse(T_p_a)
    straight = [
        camera.undistorted(uv) for camera, uv in zip(kit.cameras, (uv_p, uv_a), strict=True)
    ]

    def error(xi: Float) -> Float:
        F = epipolar.from_motion(*kit.cameras, se3.exp(xi) @ start)
        return np.concatenate([epipolar.sampson(F, *straight), xi / RIG_SIGMA])

    fit = least_squares(error, np.zeros(6), loss="soft_l1", max_nfev=20)
    return np.asarray(se3.exp(fit.x) @ start)


def triangulated(uv_p: Float, uv_a: Float, kit: KnownKit, T_a_p: Float) -> tuple[Float, np.ndarray]:
    """Triangulate matches (M, 2) px of both cameras at T_a_p.

    Returns points (M, 3) in the primary camera, spacings, and a mask (M,) of the near ones.
    """
    primary, assistant = kit.cameras
    n, rays = len(uv_p), primary.back_project(uv_p, np.ones(len(uv_p)))
    both = np.concatenate([rays[:, :2], assistant.normalized(uv_a)])
    T_c_p = np.stack([np.eye(4), T_a_p])
    X = triangulate(T_c_p, np.repeat([0, 1], n), np.tile(np.arange(n), 2), both, n)
    points = X[:, :3] / np.where(np.abs(X[:, 3:]) < 1e-9, 1e-9, X[:, 3:])
    far = assistant.project(rays @ T_a_p[:3, :3].T)
    shift = assistant.project(se3.transform(T_a_p, SOME_DEPTH * rays)) - far
    along = shift / np.maximum(np.linalg.norm(shift, axis=1, keepdims=True), 1e-9)
    parallax = ((uv_a - far) * along).sum(1)
    # an error of the rig's rotation moves all points equally: subtract the shift of the farthest
    parallax -= np.percentile(parallax, FAR_PERCENT)
    in_front = (points[:, 2] > 0) & (se3.transform(T_a_p, points)[:, 2] > 0)
    return points, in_front & (parallax > NEAR_PX)


def _pose(camera: Camera, points: Float, uv: Float, threshold_px: float) -> pnp.PoseFit | None:
    """Pose T_q_c (4, 4) of an image by PnP; None if it fails.

    c: its camera, q: the query camera. points: (M, 3) in the frame of q. camera, uv (M, 2) px: of
    the image.
    """
    try:
        return pnp.locate(camera, points, np.asarray(uv, np.float32), np.eye(4), threshold_px)
    except cv2.error:  # raised if no sample gives a model
        return None


def _double(features: Features, rows: Int) -> Float:
    return features.uv[rows].astype(np.float64)
