"""One batch of views: its ground truth, its random errors, and the prediction from both."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bench.scripted import coupled, landmarks
from bench.scripted import depth as model_depth
from bench.scripted.errors import Errors
from bench.scripted.landmarks import Bool, Sightings
from bench.scripted.pictures import given, taken_for
from bench.scripted.scene import ScriptedScene, rays
from calm_edge.geometry import se3
from calm_edge.types import Float, Float32, Hints, Int, Landmarks, Prediction

DEPTH_STRIDE = 8
# Cells of the feature grid. A feature is at a random position of its cell on a street, and at its
# centre in a room.
_STREET_GRID, _ROOM_GRID = (5, 8), (6, 10)
# Farther than this from all primary views, in world units or angle, a loop keyframe shows another
# place.
_SAME_PLACE, _SAME_WAY_RAD = 10.0, np.radians(60.0)
# Sigma of a false pose relative to a view of the batch: translation [world units], rotation [rad].
_FALSE_TWIST = np.array([1.0, 0.2, 1.5, 0.02, 0.05, 0.02])
# Minimum number of points that a loop keyframe shares with one view, to be placed.
_MIN_SHARED = 24


def false_place(t_ns: int, n_primary: int) -> tuple[int, Float]:
    """Draw a false pose for a picture of another place, exposed at t_ns.

    Returns a view's index and T_view_picture. The scripted loop finder also calls it, so that
    perceptual aliasing misleads finder and backbone alike.
    """
    rng = np.random.default_rng([t_ns % (1 << 64), n_primary])
    view = int(rng.integers(n_primary))
    return view, se3.exp(rng.standard_normal(6) * _FALSE_TWIST)


class Batch:
    """Prediction for one batch of N views.

    Pictures are undistorted by the lenses of the hints; where these are unknown a lens bends them,
    and the cameras of the prediction are pinholes all the same. The hints determine it: they seed
    the random errors.
    """

    def __init__(self, scene: ScriptedScene, errors: Errors, hints: Hints) -> None:
        self._scene, self._eyes, self._dials = scene, hints.eyes, errors.dials
        self._loop = hints.loop
        self._t_ns = scene.true_ns(hints)
        self._T_w_c = scene.T_w_c(hints.eyes, self._t_ns)
        self._n_primary = coupled.n_primary(hints.eyes, hints.loop)
        self._draw = errors.draw(hints, self._T_w_c)
        self._false_loop = self._place_false_loop()
        self._size = scene.size[hints.eyes]
        pictures = [given(*pair) for pair in zip(scene.cameras, hints.lenses, strict=True)]
        self._true = [pictures[eye] for eye in hints.eyes]
        pinholes = [taken_for(camera) for camera in pictures]
        self._cameras = tuple(
            replace(pinholes[eye], fx=pinholes[eye].fx * factor, fy=pinholes[eye].fy * factor)
            for eye, factor in zip(hints.eyes, np.exp(self._draw.focal).tolist(), strict=True)
        )
        self._sightings = self._sight()
        self._loop_found = True
        self._T = self._poses()

    def prediction(self) -> Prediction:
        """Return the prediction without depth."""
        draw = self._draw
        T_s_c = self._bent() @ se3.exp(draw.twists)
        T_s_c[:, :3, 3] *= draw.scale
        sigma = None
        if not self._dials.coupled:
            sigma = np.abs(np.array(self._dials.focal_log_error))[self._eyes] + 1e-3
        return Prediction(
            cameras=self._cameras,
            T_s_c=T_s_c,
            landmarks=self._landmarks(),
            focal_log_sigma=sigma,
            loop_found=self._loop_found,
        )

    def _bent(self) -> Float:
        """Bend the path of the poses T_s_c (N, 4, 4) into an arc by the drawn angles.

        A view's angle is applied half about the y axis of the sub-map, half about its own.
        """
        half = np.zeros((len(self._eyes), 6))
        half[:, 4] = self._draw.bend / 2
        return np.asarray(se3.exp(half) @ self._T @ se3.exp(half))

    def depth(self, views: Int) -> tuple[Float32, Float32]:
        """Depth and confidence (V, h, w) of the views with these indices.

        h, w: 1 / DEPTH_STRIDE of the picture's size.
        """
        width, height = self._scene.size.min(0) // DEPTH_STRIDE
        small = np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1).reshape(-1, 2)
        out = np.zeros((2, len(views), height, width), np.float32)
        for row, view in enumerate(views):
            zoom = self._size[view] / (width, height)
            uv = (small + 0.5) * zoom - 0.5
            z, confidence = self._depth_at(view, uv)
            at = small / (width, height)
            warp = self._dials.depth_warp * model_depth.warp(at, self._draw.phases[view])
            z *= (1 + warp) * np.exp(self._draw.depth[view]) * self._draw.scale
            out[:, row] = np.stack([z, confidence]).reshape(2, height, width)
        return out[0], out[1]

    def _depth_at(self, view: int, uv: Float) -> tuple[Float, Float]:
        """z-depth (P,) of pixels (P, 2), world units, 0 if unknown, and confidence (P,)."""
        one = slice(view, view + 1)
        (true,), (p_w,) = self._scene.surface(self._true[one], self._T_w_c[one], uv[None])
        known = np.isfinite(true)
        true, p_w = np.where(known, true, 0.0), np.where(known[:, None], p_w, 0.0)
        if not self._dials.coupled:
            return true, known.astype(np.float64)
        others = model_depth.partners(self._t_ns)[view]
        at, z = landmarks.project_all([self._true[i] for i in others], self._T_w_c[others], p_w)
        seen = known & (z > 0.1) & landmarks.inside(at, self._size[others])
        return model_depth.triangulated(
            self._T[view],
            rays(self._cameras[one], uv[None])[0],
            self._T[others],
            rays([self._cameras[i] for i in others], at),
            seen.astype(np.float64),
            self._cameras[view].fx,
        )

    def _place_false_loop(self) -> bool:
        """Give a loop keyframe of another place a false pose; return whether there is one."""
        if not self._loop:
            return False
        rest = len(self._eyes) - 1
        moved = se3.inverse(self._T_w_c[: self._n_primary]) @ self._T_w_c[rest]
        turn = np.linalg.norm(se3.so3_log(moved[:, :3, :3]), axis=1)
        apart = np.linalg.norm(moved[:, :3, 3], axis=1)
        if np.any((apart < _SAME_PLACE) & (turn < _SAME_WAY_RAD)):
            return False
        view, T_v_loop = false_place(int(self._t_ns[rest]), self._n_primary)
        self._T_w_c[rest] = self._T_w_c[view] @ T_v_loop
        return True

    def _sight(self) -> Sightings:
        """Project a grid of surface points of each view into all views."""
        scene, street = self._scene, self._scene.street is not None
        grid = _STREET_GRID if street else _ROOM_GRID
        uv = np.empty((len(self._eyes), grid[0] * grid[1], 2))
        for view, eye in enumerate(self._eyes):
            # seeded by picture, so that it has the same corners in every batch
            seed = [int(self._t_ns[view]) % (1 << 64), int(eye)]
            jitter = np.random.default_rng(seed) if street else None
            width, height = scene.size[eye]
            uv[view] = landmarks.grid_pixels(width, height, grid, jitter)
        z, p_w = scene.surface(self._true, self._T_w_c, uv)
        seeded_by, place = np.nonzero(np.isfinite(z))
        p_w = p_w[seeded_by, place]
        zoom = landmarks.MAX_ZOOM if street else np.inf
        return landmarks.sightings(p_w, seeded_by, self._true, self._T_w_c, self._size, zoom)

    def _poses(self) -> Float:
        """Poses T_s_c (N, 4, 4) in world units, before pose noise."""
        if not self._dials.coupled:
            return np.asarray(se3.inverse(self._T_w_c[0]) @ self._T_w_c)
        seen = rays(self._cameras, self._sightings.uv)
        focals = np.array([(camera.fx, camera.fy) for camera in self._cameras])
        n = len(self._eyes)
        if self._loop:
            shared = (self._sightings.seen[: self._n_primary] & self._sightings.seen[-1]).sum(1)
            if shared.max() < _MIN_SHARED:
                self._loop_found = False
                n -= 1
        T = coupled.poses(
            seen[:n],
            focals[:n],
            self._sightings,
            self._T_w_c[:n],
            self._eyes[:n],
            self._t_ns[:n],
            self._n_primary,
        )
        return T if n == len(self._eyes) else np.concatenate([T, np.eye(4)[None]])

    def _landmarks(self) -> Landmarks:
        """Landmarks with pixel noise and outliers, and with points from the predicted poses."""
        sightings, rng = self._sightings, self._draw.rng
        points, known = self._points()
        seen = sightings.seen & known
        if self._false_loop and not self._dials.false_loop_matches:
            seen[-1] = False
        view, index = np.nonzero(seen)
        uv = sightings.uv[view, index]
        uv += rng.standard_normal(uv.shape) * self._dials.match_sigma_px
        wrong = rng.uniform(size=len(uv)) < self._dials.outlier_share
        uv[wrong] = rng.uniform(size=(int(wrong.sum()), 2)) * (self._size[view[wrong]] - 1)
        kept, index = np.unique(index, return_inverse=True)
        return Landmarks(points[kept] * self._draw.scale, index, view, uv.astype(np.float32))

    def _points(self) -> tuple[Float, Bool]:
        """Points (M, 3) of the sightings in the sub-map, world units; also whether known (M,)."""
        sightings, draw = self._sightings, self._draw
        if not self._dials.coupled:
            points = se3.transform(se3.inverse(self._T_w_c[0]), sightings.p_w)
            return points, np.ones(len(points), bool)
        points = np.zeros_like(sightings.p_w)
        directions = rays(self._cameras, sightings.uv)
        for view in np.unique(sightings.seeded_by):
            own = sightings.seeded_by == view
            z, _ = model_depth.triangulated(
                self._T[view],
                directions[view, own],
                self._T,
                directions[:, own],
                sightings.seen[:, own].astype(np.float64),
                self._cameras[view].fx,
            )
            at = sightings.uv[view, own] / self._size[view]
            warp = self._dials.depth_warp * model_depth.warp(at, draw.phases[view])
            z *= (1 + warp) * np.exp(draw.depth[view])
            points[own] = np.where(
                z[:, None] > 0,
                se3.transform(self._T[view], directions[view, own] * z[:, None]),
                np.nan,
            )
        return points, np.asarray(np.isfinite(points).all(1))
