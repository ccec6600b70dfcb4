"""Pinhole camera of an undistorted picture, in the pixels of the picture as it was taken."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from calm_edge.geometry.camera import MAX_REACH_RAD, Camera, Float, Perspective
from calm_edge.geometry.fisheye import FieldTooWide, Fisheye

# Angles at which the radius of a fisheye lens is fitted, and terms that are fitted.
_ANGLES, _TERMS = 200, 4
# Pixels at which lenses are compared: columns and rows from corner to corner.
_GRID = 25, 15


@dataclass(frozen=True, slots=True)
class ThroughLens(Camera):
    """Camera that a model finds in pictures undistorted by `lens`, in pixels as taken.

    Focal lengths and centre are those of pictures undistorted to the matrix of the lens, so they
    equal the lens's if the model is right. A pixel is undistorted by the lens, then back-projected
    by `matrix`. It has no distortion of its own.
    """

    lens: Camera = field(kw_only=True)

    @property
    def max_angle(self) -> float:
        wider = min(self.lens.fx / self.fx, self.lens.fy / self.fy)
        return float(np.arctan(wider * np.tan(min(self.lens.max_angle, MAX_REACH_RAD))))

    def project(self, p_c: Float) -> Float:
        return self.lens.project(p_c @ self._to_lens.T)

    def project_jacobian(self, p_c: Float) -> Float:
        to_lens = self._to_lens
        return np.asarray(self.lens.project_jacobian(p_c @ to_lens.T) @ to_lens)

    def parameter_jacobian(self, p_c: Float) -> Float:
        slope = self.lens.project_jacobian(p_c @ self._to_lens.T)[..., :2]
        slope = slope / np.array([self.lens.fx, self.lens.fy])
        x_y, z = slope * p_c[..., None, :2], slope * p_c[..., 2, None, None]
        return np.concatenate([x_y, z], -1)

    def rays(self, uv: Float) -> Float:
        ray = self.lens.rays(uv) @ np.linalg.inv(self._to_lens).T
        return np.asarray(ray / np.linalg.norm(ray, axis=-1, keepdims=True))

    def normalized(self, uv: Float) -> Float:
        straight = self.lens.undistorted(uv)
        return np.asarray((straight - [self.cx, self.cy]) / [self.fx, self.fy])

    def scaled(self, sx: float, sy: float) -> ThroughLens:
        lens = self.lens.scaled(sx, sy)
        K = self.pinhole.scaled(sx, sy)
        return ThroughLens(K.fx, K.fy, K.cx, K.cy, lens.width, lens.height, lens=lens)

    @property
    def standard(self) -> Camera:
        """The camera of a published model that is nearest.

        Exact for a perspective lens if the focal lengths are in the ratio of the lens's, and the
        centre is that of the lens; the radius of a fisheye lens is fitted.
        """
        lens = self.lens
        zoom = float(np.sqrt(self.fx / lens.fx * self.fy / lens.fy))
        cx, cy = self.project(np.array([0.0, 0.0, 1.0])).tolist()
        optics = lens.fx * zoom, lens.fy * zoom, cx, cy, self.width, self.height
        if not isinstance(lens, Fisheye):
            powers = np.array([2, 4, 1, 1, 6, 2, 4, 6])[: len(lens.distortion)]
            return Perspective(*optics, tuple((np.array(lens.distortion) * zoom**powers).tolist()))
        end = min(self.max_angle, float(np.arctan(np.tan(min(lens.max_angle, 1.4)) / zoom)))
        angle = np.linspace(0, end, _ANGLES)[1:]
        ray = np.stack([np.sin(angle), 0 * angle, np.cos(angle)], -1)
        axial = replace(self, fx=optics[0], fy=optics[1], cx=lens.cx, cy=lens.cy)
        radius = (axial.project(ray)[:, 0] - lens.cx) / optics[0]
        powers = angle[:, None] ** np.arange(3, 3 + 2 * _TERMS, 2)
        terms = np.linalg.lstsq(powers, radius - angle, rcond=None)[0]
        try:
            return Fisheye(*optics, tuple(terms.tolist()))
        except FieldTooWide:
            return lens

    @property
    def _to_lens(self) -> Float:
        """Matrix (3, 3) that takes points in the axes of the model to those of the lens."""
        return np.asarray(np.linalg.inv(self.lens.matrix) @ self.matrix)

    def _plane(self, p_c: Float) -> Float:
        return np.asarray((self.project(p_c) - [self.cx, self.cy]) / [self.fx, self.fy])

    def _terms(self, p_c: Float) -> Float:
        return np.zeros((*p_c.shape[:-1], 2, 0))


def lens_of(camera: Camera) -> Camera | None:
    """The lens by which the pictures of a camera are undistorted; None if they are not."""
    return camera.lens if isinstance(camera, ThroughLens) else None


def lens_moved_px(one: Camera | None, other: Camera | None) -> float:
    """Largest distance [px] over the picture between two lenses' pixels of the same ray.

    inf if one of them is None, or for pictures of another size.
    """
    if one is None or other is None:
        return 0.0 if one is other else np.inf
    if (one.width, one.height) != (other.width, other.height):
        return np.inf
    if one == other:
        return 0.0
    uv = one.pixel_grid(*_GRID)
    moved = np.linalg.norm(other.project(one.rays(uv)) - uv, axis=-1)
    return float(np.nanmax(moved)) if np.isfinite(moved).any() else np.inf
