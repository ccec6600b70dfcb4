"""Points of the road, followed with the help of its plane.

On an open road everything is far but the road itself. Between two keyframes it moves by tens of
pixels and changes its shape, so that neither features nor Lucas-Kanade follow it, and nothing shows
the scale. Across the eyes it is matched well. The plane of these points, with the car's turn and
direction of travel, leaves one unknown of how the picture of the road changes: the speed, as in
Scaramuzza, "1-Point-RANSAC Structure from Motion for Vehicle-Mounted Cameras", IJCV 2011. It is
found by correlating pictures; then each picture, warped to look like its neighbour, is matched by
Lucas-Kanade. The plane only leads to the matches, and is no part of the solution.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from calm_edge.backbones.bundle.birdseye import motion
from calm_edge.backbones.bundle.edges import edges
from calm_edge.backbones.bundle.initialise import on_rig, triangulated
from calm_edge.backbones.bundle.matching import Bool, Matches
from calm_edge.backbones.bundle.problem import Measurements, State
from calm_edge.backbones.bundle.refine import refined
from calm_edge.backbones.bundle.tracks import MATCHING
from calm_edge.backbones.bundle.window import with_enough_views
from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera
from calm_edge.geometry.flow import Gray
from calm_edge.kit import layout
from calm_edge.types import Float, Float32, Int

# Largest parallax [px] of a point against the plane; points that a plane needs; planes tried.
ON_PLANE_PX, LEAST_POINTS, TRIALS = 1.0, 30, 200
# Largest sine between the direction of travel and the plane.
MOST_CLIMB = 0.15
# How exactly the plane tells where a point is found, px; least number of points found.
GUESS_PX, LEAST_FOUND = 2.0, 40
# A larger window than elsewhere: the warped road is alike all over it, and has little contrast.
ON_ROAD = replace(MATCHING, window_px=31, levels=1)


@dataclass(frozen=True, slots=True)
class Pairs:
    """N points that one view of each eye has seen: matched across the eyes only.

    view: (N,) of the primary. uv: (N, 2) px there. point: (N,) index. rays: (N, 3) in its axes, z =
    1. inverse_depth: (N,) [1 / spacings].
    """

    view: Int
    uv: Float
    point: Int
    rays: Float
    inverse_depth: Float

    def at(self, rows: Bool) -> Pairs:
        """The pairs in `rows`."""
        return Pairs(
            self.view[rows], self.uv[rows], self.point[rows],
            self.rays[rows], self.inverse_depth[rows],
        )  # fmt: skip


def with_road(
    every: Measurements, state: State, pictures: Sequence[Gray], travel: Float | None
) -> tuple[Measurements, State] | None:
    """Measurements with points of the road followed, and the state to solve them from.

    every: all points, also those of two views. state: solution of the points of more views, of
    doubtful scale and direction. pictures: of the primary's views, which come first. travel: (3,)
    direction of travel in the primary's axes, or None: along the optical axis. None if the road
    does not show the motion.
    """
    camera, assistant = layout.cameras(state.theta, every.size)
    found = pairs(every, state)
    (primary,) = np.nonzero(every.eye == 0)
    ahead = np.array([0.0, 0.0, 1.0]) if travel is None else travel
    plane = fitted(found, ahead, ON_PLANE_PX / assistant.fx)
    if plane is None:
        return None
    normal, on_plane = plane
    T = state.T_c_s[primary]
    step = T[1:] @ se3.inverse(T[:-1])
    moved = motion(pictures, step[:, :3, :3], every.t[primary], camera, normal, ahead)
    if moved is None:
        return None
    step[:, :3, 3] = -(step[:, :3, :3] @ moved[..., None])[..., 0]
    rows = list(_followed(found.at(on_plane), pictures, step, camera, normal))
    if sum(len(points) for _, points, _, _ in rows) < LEAST_FOUND:
        return None
    m = with_enough_views(_joined(every, rows))
    T_c_s = on_rig(m, state.theta, _chained(T[0], step))
    return m, State(T_c_s, triangulated(m, T_c_s, state.theta), state.theta)


def pairs(every: Measurements, state: State) -> Pairs:
    """Select and triangulate the points of a window that one view of each eye has seen."""
    own, point = every.eye[every.view] == 0, every.point
    n = len(np.bincount(point))
    views = [np.bincount(point[eye], minlength=n) for eye in (own, ~own)]
    single = (views[0] == 1) & (views[1] == 1)
    (rows,) = np.nonzero(own & single[point])
    X = triangulated(every, state.T_c_s, state.theta)[point[rows]]
    view = every.view[rows]
    p = (state.T_c_s[view] @ X[..., None])[..., 0]
    front = p[:, 2] > 0
    rows, view, p = rows[front], view[front], p[front]
    z = p[:, 2:3]
    return Pairs(view, every.uv[rows], point[rows], p[:, :3] / z, (p[:, 3:] / z)[:, 0])


def fitted(found: Pairs, ahead: Float, tolerance: float) -> tuple[Float, Bool] | None:
    """Fit a plane that the car drives along: normal over distance (3,), and its points (N,).

    The inverse depth of a plane is linear in the ray: the normal over the distance, times the ray.
    ahead: (3,) direction of travel. tolerance: of the inverse depth. None if no plane is found.
    """
    rays, depth = found.rays, found.inverse_depth
    if len(depth) < LEAST_POINTS:
        return None
    rng = np.random.default_rng(len(depth))
    best = np.zeros(len(depth), bool)
    for _ in range(TRIALS):
        chosen = rng.choice(len(depth), 3, replace=False)
        normal = _normal(rays[chosen], depth[chosen])
        if abs(normal @ ahead) > MOST_CLIMB * np.linalg.norm(normal) * np.linalg.norm(ahead):
            continue
        near = np.abs(rays @ normal - depth) < tolerance
        if near.sum() > best.sum():
            best = near
    if best.sum() < LEAST_POINTS:
        return None
    normal = _normal(rays[best], depth[best])
    return normal, np.abs(rays @ normal - depth) < tolerance


def _normal(rays: Float, inverse_depth: Float) -> Float:
    return np.asarray(np.linalg.lstsq(rays, inverse_depth, rcond=None)[0])


def _followed(
    found: Pairs,
    pictures: Sequence[Gray],
    step: Float,
    camera: Camera,
    normal: Float,
) -> Iterator[tuple[int, Int, Matches, Float32]]:
    """Matches of the pairs' points in the views before and after theirs: view, points, matches.

    With the edges (N, 2) there, as in `Measurements.edge`.
    """
    back = se3.inverse(step)
    for view, picture in enumerate(pictures):
        own = found.at(found.view == view)
        neighbours = [(view + 1, step[view])] if view < len(step) else []
        neighbours += [(view - 1, back[view - 1])] if view else []
        for there, T in neighbours:
            matches = _matched(picture, pictures[there], own.uv, T, camera, normal)
            sure = matches.measured
            part = Matches(matches.uv[sure], sure[sure], matches.sigma_px[sure], sure[sure])
            yield there, own.point[sure], part, edges(pictures[there], part.uv)


def _matched(a: Gray, b: Gray, uv: Float, T_b_a: Float, camera: Camera, normal: Float) -> Matches:
    """Match points uv (N, 2) px of the road in picture a to b, warped to look like a."""
    at, none = uv.astype(np.float32), np.zeros(len(uv), bool)
    if not len(uv):
        return Matches(at, none, np.zeros(0, np.float32), none)
    top = max(int(at[:, 1].min()) - ON_ROAD.window_px, 0)
    there = _seen_in(T_b_a, camera, normal, a.shape, top)
    side = np.ones((ON_ROAD.window_px, ON_ROAD.window_px), np.uint8)
    whole = cv2.erode(np.asarray(there[..., 0] >= 0, np.uint8), side)
    column, row = np.round(at).astype(int).T
    sure = np.asarray(whole)[row - top, column] > 0
    alike = np.asarray(cv2.remap(b, there[..., 0], there[..., 1], cv2.INTER_LINEAR), np.uint8)
    below = at - np.array([0, top], np.float32)
    guess = Matches(below, sure, np.full(len(at), GUESS_PX, np.float32), none)
    found = refined(np.ascontiguousarray(a[top:]), alike, below, guess, ON_ROAD)
    uv_b = cv2.remap(there, found.uv[:, :1], found.uv[:, 1:], cv2.INTER_LINEAR)[:, 0]
    measured = sure & found.measured
    return Matches(np.asarray(uv_b, np.float32), measured, found.sigma_px, measured)


def _seen_in(
    T_b_a: Float, camera: Camera, normal: Float, shape: tuple[int, ...], top: int
) -> Float32:
    """Where view b sees what pixels of view a show of the road: (H - top, W, 2) px, -1 for not.

    shape: (H, W) of a picture. top: first row of a.
    """
    height, width = shape
    x, y = np.meshgrid(np.arange(width), np.arange(top, height))
    rays = _on_plane(camera, np.stack([x, y], -1).reshape(-1, 2).astype(np.float64))
    inverse = rays @ normal
    points = rays / np.where(inverse > 0, inverse, np.inf)[:, None] @ T_b_a[:3, :3].T + T_b_a[:3, 3]
    there = camera.project(points)
    seen = (inverse > 0) & camera.within_reach(points)
    seen &= (there >= 0).all(1) & (there <= [width - 1, height - 1]).all(1)
    return np.where(seen[:, None], there, -1).astype(np.float32).reshape(*x.shape, 2)


def _joined(every: Measurements, rows: Sequence[tuple[int, Int, Matches, Float32]]) -> Measurements:
    """Measurements with further rows, in order of the view."""
    view = np.concatenate([every.view, *(np.full(len(p), v) for v, p, _, _ in rows)])
    order = np.argsort(view, kind="stable")
    edge = np.zeros_like(every.uv) if every.edge is None else every.edge
    return replace(
        every,
        view=view[order],
        point=np.concatenate([every.point, *(p for _, p, _, _ in rows)])[order],
        uv=np.concatenate([every.uv, *(found.uv for _, _, found, _ in rows)])[order],
        sigma_px=np.concatenate([every.sigma_px, *(f.sigma_px for _, _, f, _ in rows)])[order],
        edge=np.concatenate([edge, *(along for *_, along in rows)])[order],
    )


def _chained(first: Float, step: Float) -> Float:
    """Poses T_c_s (S + 1, 4, 4) from the first one and the steps, each from a view to the next."""
    out = [first]
    for T in step:
        out.append(T @ out[-1])
    return np.stack(out)


def _on_plane(camera: Camera, uv: Float) -> Float:
    """Rays (N, 3) with z = 1 of pixels (N, 2)."""
    q = camera.normalized(uv)
    return np.concatenate([np.where(np.isfinite(q), q, 0.0), np.ones((len(q), 1))], 1)
