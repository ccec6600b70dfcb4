"""Initial poses, points and rig from matches and a rough focal.

The primary views are placed along the path of a car (travel.py), or by incremental structure from
motion: two views by their essential matrix, the others by resection (PnP). The assistant's views
are placed by the rig, or by resection where the rig is unknown, at any rotation to the primary.
Until the spacing is found, lengths are in the *initial unit*: the median step of the car's path, or
the distance of the first two views; then in spacings.
"""

from __future__ import annotations

from collections.abc import Iterator
from enum import Enum, auto

import cv2
import numpy as np

from calm_edge.backbones.base import BackboneError
from calm_edge.backbones.bundle import travel
from calm_edge.backbones.bundle.problem import Measurements, State
from calm_edge.backbones.bundle.rig_search import (
    MIN_RESECTION,
    RESECTION_PX,
    fitted_rig,
    side_by_side,
    spacing_of,
    usable,
)
from calm_edge.geometry import se3
from calm_edge.geometry.triangulation import triangulate
from calm_edge.kit import layout
from calm_edge.types import Float, Int

MIN_COMMON = 30

# T_c_s (4, 4) by view
Poses = dict[int, Float]


def normalised(m: Measurements, theta: Float) -> Float:
    """Rays (O, 2) on z = 1 of all observations; without distortion where it cannot be undone.

    theta: the kit, for the optics.
    """
    out = np.empty_like(m.uv)
    for eye, camera in enumerate(layout.cameras(theta, m.size)):
        rows = m.eye[m.view] == eye
        rays = camera.normalized(m.uv[rows])
        out[rows] = np.where(np.isfinite(rays), rays, camera.pinhole.normalized(m.uv[rows]))
    return out


def _focals(m: Measurements, theta: Float) -> list[float]:
    return [camera.fx for camera in layout.cameras(theta, m.size)]


def _rows_of(m: Measurements, view: int) -> Int:
    return np.flatnonzero(m.view == view)


def two_views(m: Measurements, rays: Float, first: int, second: int, f: float) -> Float | None:
    """T_second_first (4, 4), unit translation, or None with too few inliers.

    first, second: view indices. rays: (O, 2) of all observations, on z = 1. f: focal [px], for the
    inlier threshold of a pixel. cv2.findEssentialMat with USAC_MAGSAC, then cv2.recoverPose.
    """
    a, b = _rows_of(m, first), _rows_of(m, second)
    _, ia, ib = np.intersect1d(m.point[a], m.point[b], return_indices=True)
    if len(ia) < MIN_COMMON:
        return None
    pa, pb = rays[a[ia]], rays[b[ib]]
    try:
        E, mask = cv2.findEssentialMat(
            pa, pb, np.eye(3), method=cv2.USAC_MAGSAC, prob=0.999, threshold=1.0 / f
        )
    except cv2.error:  # raised if no sample gives a model
        return None
    if E is None or E.shape != (3, 3):
        return None
    count, R, t, _ = cv2.recoverPose(E, pa, pb, np.eye(3), mask=mask.copy())
    if count < MIN_COMMON // 2:
        return None
    return se3.compose(np.asarray(R, np.float64), np.asarray(t, np.float64).ravel())


def resection(points: Float, rays: Float, f: float, guess: Float | None) -> Float | None:
    """T_c_s (4, 4) of a view that sees known points (n, 3) along rays (n, 2), or None.

    cv2.solvePnPRansac with SQPNP, then cv2.solvePnPRefineLM. f: focal [px], for the inlier
    threshold RESECTION_PX. guess: returned with too few inliers.
    """
    if len(points) < MIN_RESECTION:
        return None
    K = np.eye(3)
    ok, rvec, tvec, inliers = cv2.solvePnPRansac(
        points, rays, K, None, iterationsCount=200, reprojectionError=RESECTION_PX / f,
        confidence=0.999, flags=cv2.SOLVEPNP_SQPNP,
    )  # fmt: skip
    if not ok or inliers is None or len(inliers) < MIN_RESECTION:
        return guess
    i = inliers.ravel()
    rvec, tvec = cv2.solvePnPRefineLM(points[i], rays[i], K, None, rvec, tvec)
    rotation, translation = (np.asarray(v, np.float64).ravel() for v in (rvec, tvec))
    return se3.compose(se3.so3_exp(rotation), translation)


def driven(m: Measurements, theta: Float, remembered: Float | None) -> Iterator[Poses]:
    """Poses T_c_s of the primary views along the path of a car (travel.py), two guesses a course.

    First with the steps from ratios of neighbouring ones, then with those of a constant speed.
    theta: the kit, for the focal. remembered: (3,) direction of travel, camera axes, or None.
    """
    matches = travel.matches(m, normalised(m, theta), _focals(m, theta)[0])
    primary = np.flatnonzero(m.eye == 0).tolist()
    for course in travel.courses(matches, remembered):
        for steps in (travel.signed_steps(matches, course), matches.dt / np.median(matches.dt)):
            yield dict(zip(primary, course.path(steps), strict=True))


def chained(m: Measurements, theta: Float, seed_share: float) -> Poses:
    """T_c_s of the primary views by incremental structure from motion; raises BackboneError.

    The first pair is the first primary view and the one at `seed_share` (0 to 1) of the window.
    """
    rays = normalised(m, theta)
    n_points = int(m.point.max()) + 1
    primary = np.flatnonzero(m.eye == 0)
    f = _focals(m, theta)
    poses = _seed(m, rays, primary, f[0], seed_share)
    X = _triangulate_known(m, rays, poses, n_points)
    for view in _outward(primary, list(poses)):
        pose = _resect(m, rays, X, view, f[0], _nearest(poses, view))
        if pose is None:
            raise BackboneError("bundle: a keyframe shares too few matches with its neighbours")
        poses[view] = pose
        X = _triangulate_known(m, rays, poses, n_points)
    return poses


class Rig(Enum):
    """Where the rig of an initial state is from.

    KNOWN: the kit. FITTED: the window. ABREAST: its rotation from the window, its position beside
    the primary.
    """

    KNOWN = auto()
    FITTED = auto()
    ABREAST = auto()


def initial_state(m: Measurements, theta: Float, rig: Rig, poses: Poses) -> State:
    """Poses of all views, points and kit; raises BackboneError where the matches do not suffice.

    theta: the kit. poses: of the primary views, in any unit.
    """
    rays = normalised(m, theta)
    n_points = int(m.point.max()) + 1
    primary, assistant = np.flatnonzero(m.eye == 0), np.flatnonzero(m.eye == 1)
    f = _focals(m, theta)
    X = _triangulate_known(m, rays, poses, n_points)
    T_s_p = se3.inverse(np.stack([poses[int(v)] for v in primary]))
    instants = m.t[assistant] + theta[layout.TIME_OFFSET]
    at = se3.interpolate_at(m.t[primary], T_s_p, instants)  # primary, when the assistant exposes
    theta = theta.copy()
    if rig is Rig.KNOWN:
        spacing, _ = spacing_of(m, theta, X, assistant, at)
    else:
        found = _resected(m, rays, X, assistant, at, f[1])
        T_p_a, theta = fitted_rig(m, theta, X, assistant, at, found)
        spacing = float(np.linalg.norm(T_p_a[:3, 3]))
        theta[layout.RIG] = layout.rig_vector(T_p_a)
    if rig is Rig.ABREAST:
        theta, spacing = side_by_side(m, theta, X, assistant, at)
    T_s_p[:, :3, 3] /= spacing
    out = on_rig(m, theta, se3.inverse(T_s_p))
    return State(out, triangulated(m, out, theta), theta)


def on_rig(m: Measurements, theta: Float, T_p_s: Float) -> Float:
    """Poses T_c_s (C, 4, 4) of all views, the assistant's exactly on the rig.

    T_p_s: (P, 4, 4) of the primary's views, in spacings.
    """
    primary, assistant = np.flatnonzero(m.eye == 0), np.flatnonzero(m.eye == 1)
    instants = m.t[assistant] + theta[layout.TIME_OFFSET]
    at = se3.interpolate_at(m.t[primary], se3.inverse(T_p_s), instants)
    out = np.empty((m.n_views, 4, 4))
    out[primary], out[assistant] = T_p_s, se3.inverse(at @ layout.rig(theta))
    return out


def triangulated(m: Measurements, T_c_s: Float, theta: Float) -> Float:
    """Triangulate all points (M, 4), homogeneous; those seen in one view only are at infinity."""
    n_points = int(m.point.max()) + 1
    X = triangulate(T_c_s, m.view, m.point, normalised(m, theta), n_points, m.edge)
    return np.where(np.isfinite(X[:, :1]), X, [0.0, 0.0, 1.0, 0.0])


def _seed(m: Measurements, rays: Float, primary: Int, f: float, share: float) -> dict[int, Float]:
    """Poses T_c_s of the first pair: the first view, and the view `share` of the window later."""
    second = int(primary[max(1, int(share * (len(primary) - 1)))])
    T = two_views(m, rays, int(primary[0]), second, f)
    if T is None:
        raise BackboneError("bundle: the first keyframes share too few matches")
    return {int(primary[0]): np.eye(4), second: T}


def _triangulate_known(
    m: Measurements, rays: Float, poses: dict[int, Float], n_points: int
) -> Float:
    stack = np.tile(np.eye(4), (m.n_views, 1, 1))
    for view, T in poses.items():
        stack[view] = T
    known = np.isin(m.view, list(poses))
    edge = None if m.edge is None else m.edge[known]
    return triangulate(stack, m.view[known], m.point[known], rays[known], n_points, edge)


def _resect(
    m: Measurements, rays: Float, X: Float, view: int, f: float, guess: Float | None
) -> Float | None:
    rows = _rows_of(m, view)
    rows = rows[usable(X[m.point[rows]])]
    points = X[m.point[rows]]
    return resection(points[:, :3] / points[:, 3:], rays[rows], f, guess)


def _outward(primary: Int, known: list[int]) -> list[int]:
    """Views to resect, in order: those between the views with a pose, then those after them."""
    return [int(v) for v in primary if v not in known and v < max(known)] + [
        int(v) for v in primary if v > max(known)
    ]


def _nearest(poses: dict[int, Float], view: int) -> Float:
    return poses[min(poses, key=lambda v: (abs(v - view), v))]


def _resected(
    m: Measurements, rays: Float, X: Float, assistant: Int, at: Float, f: float
) -> list[Float]:
    """T_p_a (4, 4), initial unit, of every assistant view that resection places.

    X: (M, 4) points. assistant: (A,) view indices. at: (A, 4, 4) poses T_s_p of the primary
    interpolated to their exposures. f: the assistant's focal [px].
    """
    found = []
    for view, T_s_p in zip(assistant, at, strict=True):
        pose = _resect(m, rays, X, int(view), f, None)
        if pose is not None:
            found.append(se3.inverse(pose @ T_s_p))
    if not found:
        raise BackboneError("bundle: no matches between the cameras; let them see the same scene")
    return found
