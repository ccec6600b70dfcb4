"""Measurements of a window, from pictures or from the landmarks of an earlier solution."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from calm_edge.backbones.base import BackboneError
from calm_edge.backbones.bundle.matching import FOLLOWED_PX, Matching
from calm_edge.backbones.bundle.problem import Measurements, State, project
from calm_edge.backbones.bundle.tracks import Tracks, window_tracks
from calm_edge.geometry import picture_mask, se3
from calm_edge.geometry.camera import Camera
from calm_edge.geometry.fisheye import FieldTooWide
from calm_edge.kit import layout
from calm_edge.types import Bytes, Float, Hints, Int, Landmarks, Masks, Prediction

MIN_VIEWS_OF_A_POINT = 3
MIN_POINTS = 40
FARTHEST = 1e6  # distance [spacings] stored for points at infinity
RESCALED = 0.3  # log of the spacing beyond which a window's start is brought to the right scale
# Pixels across and down at which lenses are compared; largest angle off the axis, for a homography
# between them; least share of these pixels that a lens must show.
GRID, MAX_GUIDED_DEG, LEAST_SEEN = (9, 9), 80.0, 0.9
KEPT_PX = 5.0  # observations with a larger reprojection error are dropped


def split_eyes(hints: Hints) -> tuple[Int, Int]:
    """Batch indices of the primary and the assistant views; raises BackboneError."""
    eyes = np.asarray(hints.eyes)
    primary, assistant = np.flatnonzero(eyes == 0), np.flatnonzero(eyes == 1)
    if len(primary) < 2 or len(assistant) < 1:
        raise BackboneError("bundle: needs two primary pictures and one of the assistant at least")
    if np.any(np.diff(eyes) < 0) or np.any(np.diff(hints.t_ns[primary]) <= 0):
        raise BackboneError("bundle: pictures must be in order: primary by time, then assistant")
    return primary, assistant


def seconds(hints: Hints) -> Float:
    """Times of exposure (N,), as far as known, in seconds since the first stamp."""
    stamped = np.asarray((hints.t_ns - hints.t_ns[0]) * 1e-9)
    return stamped if hints.late_s is None else stamped + hints.late_s


def with_known_offset(prediction: Prediction, hints: Hints) -> Prediction:
    """Add the known offsets of the assistant's stamps to those that the window has found."""
    if hints.late_s is None:
        return prediction
    known = hints.late_s[np.asarray(hints.eyes) == 1]
    found = prediction.stamps_off_s
    return replace(prediction, stamps_off_s=known if found is None else known + found)


def measure(
    images: Sequence[NDArray[np.uint8]],
    hints: Hints,
    kits: Sequence[Float],
    rig_known: bool,
    matching: Matching | None = None,
) -> Measurements:
    """Matches of all pictures (H, W, 3) as measurements, of two views or more each.

    kits: one, which guides the matching between the cameras when `rig_known`, or several that may
    be right. matching: by a network; None for Lucas-Kanade.
    """
    primary, assistant = split_eyes(hints)
    gray = [np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8) for image in images]
    t = seconds(hints)
    partner = [int(np.argmin(np.abs(t[primary] - t[j]))) for j in assistant]
    size = np.array([gray[primary[0]].shape[::-1], gray[assistant[0]].shape[::-1]])
    lenses = [layout.cameras(theta, size) for theta in kits]
    H_a_p = _infinite_homography(lenses[0], layout.rig(kits[0])) if rig_known else None
    eyes = [[gray[i] for i in views] for views in (primary, assistant)]
    masks = hints.masks or Masks()
    used = _used(masks.primary, size[0]), _used(masks.assistant, size[1])
    tracks = window_tracks(eyes[0], eyes[1], partner, H_a_p, matching, lenses, used)
    return _measurements(tracks, hints, size)


def _used(mask: Bytes | None, size: Int) -> Bytes | None:
    """(H, W), 0 where a picture of size width, height is left out; None: all of it is used."""
    return None if mask is None else picture_mask.kept(mask, (int(size[1]), int(size[0])))


def _infinite_homography(lenses: tuple[Camera, Camera], T_p_a: Float) -> Float:
    """H_a_p (3, 3) px of points at infinity, from primary to assistant.

    With distortion the homography that comes nearest to their motion, over a grid of pixels.
    """
    primary, assistant = lenses
    R_a_p = T_p_a[:3, :3].T
    if primary.is_pinhole and assistant.is_pinhole:
        return np.asarray(assistant.matrix @ R_a_p @ np.linalg.inv(primary.matrix))
    uv = primary.pixel_grid(*GRID)
    rays = primary.rays(uv) @ R_a_p.T
    seen = rays[:, 2] > np.cos(min(assistant.max_angle, np.radians(MAX_GUIDED_DEG)))
    H, _ = cv2.findHomography(uv[seen], assistant.project(rays[seen]))
    if H is None:
        raise BackboneError("bundle: the cameras look in different directions")
    return np.asarray(H, np.float64)


def _measurements(tracks: Tracks, hints: Hints, size: Int) -> Measurements:
    _, of, count = np.unique(tracks.track, return_inverse=True, return_counts=True)
    keep = count[of] >= 2
    order = np.flatnonzero(keep)[np.argsort(tracks.view[keep], kind="stable")]
    return Measurements(
        tracks.view[order],
        np.unique(tracks.track[order], return_inverse=True)[1],
        tracks.uv[order],
        tracks.sigma_px[order],
        np.asarray(hints.eyes),
        seconds(hints),
        size,
        tracks.edge[order],
    )


def with_enough_views(every: Measurements) -> Measurements:
    """Points of MIN_VIEWS_OF_A_POINT at least; raises BackboneError when they are too few."""
    kept = every.at(np.bincount(every.point)[every.point] >= MIN_VIEWS_OF_A_POINT)
    ids, point = np.unique(kept.point, return_inverse=True)
    if len(ids) < MIN_POINTS:
        raise BackboneError(f"bundle: only {len(ids)} points could be followed")
    return replace(kept, point=point)


def thinned(m: Measurements, n_points: int) -> Measurements:
    """Measurements of the `n_points` points that are seen in most views, as corners if possible."""
    corner = None if m.edge is None else 1 - (m.edge**2).sum(1)
    count = np.bincount(m.point, corner)
    kept = np.sort(np.argsort(-count, kind="stable")[:n_points])
    rows = np.isin(m.point, kept)
    point = np.searchsorted(kept, m.point[rows])
    return replace(m.at(rows), point=point)


def without(m: Measurements, state: State, gone: NDArray[np.bool_]) -> tuple[Measurements, State]:
    """Measurements and state without some of the points; gone: (M,)."""
    rows = ~gone[m.point]
    left = replace(m.at(rows), point=(np.cumsum(~gone) - 1)[m.point[rows]])
    return left, replace(state, points=state.points[~gone])


def lenses(state: State, m: Measurements) -> tuple[Camera, Camera]:
    """Camera of each eye in a state; raises BackboneError if none shows such a picture.

    The outermost corners may be missing: so it is with strong distortion of low degree.
    """
    try:
        cameras = layout.cameras(state.theta, m.size)
    except FieldTooWide as error:
        raise BackboneError(f"bundle: {error}") from None
    for camera in cameras:
        seen = np.isfinite(camera.rays(camera.pixel_grid(*GRID))[:, 0])
        if seen.mean() < LEAST_SEEN:
            raise BackboneError("bundle: the lens that fits best does not show the whole picture")
    return cameras


def to_landmarks(state: State, m: Measurements) -> Landmarks:
    """Convert the solved points to landmarks, with the observations that fit them.

    Points at or beyond infinity (w <= 0) are placed at FARTHEST. sigma_px is None if all sigmas are
    FOLLOWED_PX. What a match may have slid along an edge is taken back.
    """
    X = state.points.copy()
    X[:, 3] = np.maximum(X[:, 3], np.linalg.norm(X[:, :3], axis=1) / FARTHEST)
    predicted, _ = project(State(state.T_c_s, X, state.theta), m)
    error = m.uv - predicted
    edge = np.zeros_like(error) if m.edge is None else m.edge
    slid = edge * (edge * error).sum(1, keepdims=True)
    keep = np.linalg.norm(error - slid, axis=1) < KEPT_PX
    for eye, camera in enumerate(layout.cameras(state.theta, m.size)):
        rows = np.flatnonzero(m.eye[m.view] == eye)
        keep[rows[~np.isfinite(camera.rays(m.uv[rows])[:, 0])]] = False
    alike = bool((m.sigma_px == FOLLOWED_PX).all())
    sigma = None if alike else m.sigma_px[keep].astype(np.float32)
    uv = (m.uv - slid)[keep].astype(np.float32)
    along = None if m.edge is None else m.edge[keep].astype(np.float32)
    return Landmarks(X[:, :3] / X[:, 3:], m.point[keep], m.view[keep], uv, sigma, along)


def from_prediction(
    prediction: Prediction, hints: Hints, theta: Float
) -> tuple[Measurements, State]:
    """Measurements and initial state to solve a window again, from its earlier prediction.

    theta: the kit to start from, instead of the earlier one.

    Raises BackboneError.
    """
    marks = prediction.landmarks
    if marks is None or hints.sizes is None:
        raise BackboneError("bundle: a prediction without landmarks cannot be solved again")
    sigma = np.full(len(marks.index), FOLLOWED_PX)
    if marks.sigma_px is not None:
        sigma = marks.sigma_px.astype(np.float64)
    edge = None if marks.edge is None else marks.edge.astype(np.float64)
    m = Measurements(
        marks.view, marks.index, marks.uv.astype(np.float64), sigma,
        np.asarray(hints.eyes), seconds(hints), hints.sizes, edge,
    )  # fmt: skip
    length = _spacing(prediction.T_s_c, m)
    X = np.c_[marks.points_s, np.full(len(marks.points_s), length)]
    X /= np.linalg.norm(X, axis=1, keepdims=True)
    T_s_c = prediction.T_s_c.copy()
    T_s_c[:, :3, 3] /= length
    return m, State(se3.inverse(T_s_c), X, theta)


def _spacing(T_s_c: Float, m: Measurements) -> float:
    """Length of T_p_a at the times of exposure, which differs from 1 if these are corrected."""
    primary = m.eye == 0
    at = se3.interpolate_at(m.t[primary], T_s_c[primary], m.t[~primary])
    T_p_a = se3.inverse(at) @ T_s_c[~primary]
    length = float(np.linalg.norm(np.median(T_p_a[:, :3, 3], axis=0)))
    return length if abs(np.log(max(length, 1e-3))) > RESCALED else 1.0
