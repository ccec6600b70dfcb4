"""Whether a picture of the past shows the place that both eyes see now (paper IV-D).

Two pictures with enough matches on one epipolar geometry are not yet one place: a far ridge or a
wall like another give that too. So the two eyes' own geometry gives points in depth; one pose of
the past picture has to explain the near ones and the rest of its matches; and then most of what
both eyes see, matched or not, has to be in the past picture where that pose puts it.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.optimize import least_squares

from calm_edge.geometry import epipolar, pnp, se3
from calm_edge.geometry.camera import Camera
from calm_edge.geometry.sift import Features, cells, consistent, well_spread
from calm_edge.types import Float, Float32, Int

REFERENCE_WIDTH_PX = 640  # thresholds below are for such a picture; they grow with its width
EPIPOLAR_PX = 1.0
POSE_PX = 3.0
# What the eyes' pictures say of the rig at their two instants, against what the rig is at one.
# Tens of milliseconds at speed: mostly a step ahead, and a little of a turn.
RIG_SIGMA = np.array([0.1, 0.1, 0.5, 0.01, 0.01, 0.01])  # spacings x, y, z, then rad
# A point is near when its parallax between the eyes is so much more than that of the farthest.
NEAR_PX = 2.0
FAR_PERCENT = 10.0
SOME_DEPTH = 10.0  # spacings: any will do to say which way parallax goes
MIN_AGREEING = 0.6
# What is looked for under the pose: so near its predicted pixel and so like it (cosine).
SEEN_AGAIN_PX = 8.0
SEEN_AGAIN_LIKENESS = 0.8
MIN_SEEN_AGAIN = 0.5
FARTHEST = 40.0  # spacings between the two pictures
WIDEST_RAD = np.radians(60.0)


@dataclass(frozen=True, slots=True)
class KnownKit:
    """cameras: one an eye. T_p_a: (4, 4), any unit: only its direction is used."""

    cameras: tuple[Camera, Camera]
    T_p_a: Float


@dataclass(frozen=True, slots=True)
class SamePlace:
    """One pose explains what both pictures show of it.

    T_query_match: (4, 4) match->query, in spacings, rough. seen_again: share of what the eyes see
    now that the past picture has too.
    """

    T_query_match: Float
    seen_again: float

    @property
    def is_same(self) -> bool:
        """Whether it is that place, and not one that looks like it in part."""
        return self.seen_again >= MIN_SEEN_AGAIN


def same_place(
    query: Features,
    assistant: Features,
    past: Features,
    kit: KnownKit,
    size: Int,
    min_matches: int,
) -> SamePlace | None:
    """The past picture's place against a primary picture and the assistant's of that time.

    size: (2,) width, height [px] of the primary's pictures. min_matches: on one geometry with the
    past picture; a third as many near points. None where no pose explains the pictures.
    """
    stretch = float(size[0]) / REFERENCE_WIDTH_PX
    pairs = consistent(query, past, EPIPOLAR_PX * stretch)
    if len(pairs) < min_matches or not well_spread(query.uv[pairs[:, 0]], size):
        return None
    across = consistent(query, assistant, EPIPOLAR_PX * stretch)
    shared, in_past, in_assistant = np.intersect1d(
        pairs[:, 0], across[:, 0], assume_unique=True, return_indices=True
    )
    if len(shared) < min_matches // 3:
        return None
    uv_q, uv_a = _double(query, across[:, 0]), _double(assistant, across[:, 1])
    all_points, all_near = triangulated(uv_q, uv_a, kit, rig_between(uv_q, uv_a, kit))
    points, near = all_points[in_assistant], all_near[in_assistant]
    uv_past = past.uv[pairs[in_past, 1]]
    fit = _pose(kit.cameras[0], points[near], uv_past[near], POSE_PX * stretch)
    if fit is None or fit.n_inliers < max(min_matches // 3, MIN_AGREEING * near.sum()):
        return None
    if not well_spread(query.uv[shared[near][fit.inlier]], size):
        return None
    T = fit.T_w_c
    if np.linalg.norm(T[:3, 3]) > FARTHEST or np.linalg.norm(se3.so3_log(T[:3, :3])) > WIDEST_RAD:
        return None
    F = epipolar.from_motion(kit.cameras[0], kit.cameras[0], se3.inverse(T))
    miss = np.abs(epipolar.sampson(F, _double(query, pairs[:, 0]), _double(past, pairs[:, 1])))
    if np.mean(miss < POSE_PX * stretch) < MIN_AGREEING:
        return None
    again = seen_again(all_points, query.vector[across[:, 0]], past, kit.cameras[0], T, size)
    return SamePlace(T, again)


def seen_again(
    points: Float, vectors: Float32, past: Features, camera: Camera, T_q_past: Float, size: Int
) -> float:
    """The share of points (M, 3) that the past picture shows where T_q_past (4, 4) puts them.

    points: query camera, with their descriptors (M, 128). size: (2,) width, height px. Each cell
    of the query picture counts the same: a tiled wall has more points than the trees above it.
    """
    p = se3.transform(se3.inverse(T_q_past), points)
    front = (points[:, 2] > 0) & (p[:, 2] > 0)
    if not front.any() or len(past.uv) == 0:
        return 0.0
    uv = camera.project(p[front])
    likeness = vectors[front] @ past.vector.T
    away = np.linalg.norm(uv[:, None] - past.uv[None], axis=2)
    away /= float(size[0]) / REFERENCE_WIDTH_PX
    there = ((likeness > SEEN_AGAIN_LIKENESS) & (away < SEEN_AGAIN_PX)).any(1)
    _, cell = np.unique(cells(camera.project(points[front]), size), return_inverse=True)
    return float((np.bincount(cell, there) / np.bincount(cell)).mean())


def rig_between(uv_p: Float, uv_a: Float, kit: KnownKit) -> Float:
    """T_a_p (4, 4), spacings, of two pictures from their matches (M, 2) px.

    The rig is known; between two instants it moved with the car, a little.
    """
    T_p_a = np.array(kit.T_p_a)
    T_p_a[:3, 3] /= np.linalg.norm(T_p_a[:3, 3])
    start = se3.inverse(T_p_a)

    def error(xi: Float) -> Float:
        F = epipolar.from_motion(*kit.cameras, se3.exp(xi) @ start)
        return np.concatenate([epipolar.sampson(F, uv_p, uv_a), xi / RIG_SIGMA])

    fit = least_squares(error, np.zeros(6), loss="soft_l1", max_nfev=20)
    return np.asarray(se3.exp(fit.x) @ start)


def triangulated(uv_p: Float, uv_a: Float, kit: KnownKit, T_a_p: Float) -> tuple[Float, np.ndarray]:
    """Points (M, 3) of matches (M, 2) px, primary camera, and which (M,) are near and in front."""
    primary, assistant = kit.cameras
    points = epipolar.triangulated(primary, assistant, T_a_p, uv_p, uv_a)
    rays = primary.back_project(uv_p, np.ones(len(uv_p)))
    far = assistant.project(rays @ T_a_p[:3, :3].T)
    shift = assistant.project(se3.transform(T_a_p, SOME_DEPTH * rays)) - far
    along = shift / np.maximum(np.linalg.norm(shift, axis=1, keepdims=True), 1e-9)
    parallax = ((uv_a - far) * along).sum(1)
    # a small error of the rig's rotation moves all points alike: the farthest tell by how much
    parallax -= np.percentile(parallax, FAR_PERCENT)
    in_front = (points[:, 2] > 0) & (se3.transform(T_a_p, points)[:, 2] > 0)
    return points, in_front & (parallax > NEAR_PX)


def _pose(camera: Camera, points: Float, uv: Float, threshold_px: float) -> pnp.PoseFit | None:
    """The picture's T_q_c (4, 4) from points (M, 3) of the query camera and pixels (M, 2)."""
    try:
        return pnp.locate(camera, points, np.asarray(uv, np.float32), np.eye(4), threshold_px)
    except cv2.error:  # its own assertion, where no sample gives a model
        return None


def _double(features: Features, rows: Int) -> Float:
    return features.uv[rows].astype(np.float64)
