"""Cameras of the pictures that a scripted backbone is given, and what a network takes them for."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from calm_edge.geometry.camera import Camera, Float, Perspective
from calm_edge.geometry.undistortion import undistortion

# Pixels to which a pinhole camera is fitted, and rays farther off the axis are left out.
_GRID = 25, 15
_LEAST_Z = float(np.cos(np.radians(60.0)))


@dataclass(frozen=True, slots=True)
class UndistortedBy(Perspective):
    """Camera of pictures taken by `true` and undistorted by `lens`, which may differ from it.

    The other fields are those of the undistorted picture; what the lens leaves is no pinhole.
    """

    true: Camera = field(kw_only=True)
    lens: Camera = field(kw_only=True)

    @property
    def is_pinhole(self) -> bool:
        return False

    @property
    def max_angle(self) -> float:
        return self.true.max_angle

    def project(self, p_c: Float) -> Float:
        return self.pinhole.project(self.lens.rays(self.true.project(p_c)))

    def normalized(self, uv: Float) -> Float:
        return self.true.normalized(self.lens.project(self.pinhole.rays(uv)))


@lru_cache(maxsize=8)
def given(true: Camera, lens: Camera | None) -> Camera:
    """Camera of pictures by `true`, as taken, or undistorted by a lens that is known."""
    if lens is None or lens.is_pinhole:
        return true
    P = undistortion(lens).camera
    if lens == true:
        return P
    return UndistortedBy(P.fx, P.fy, P.cx, P.cy, P.width, P.height, true=true, lens=lens)


def taken_for(camera: Camera) -> Perspective:
    """The pinhole camera that fits a camera best: a network knows no other."""
    if camera.is_pinhole:
        return camera.pinhole
    uv = camera.pixel_grid(*_GRID)
    rays = camera.rays(uv)
    seen = rays[:, 2] > _LEAST_Z
    q = rays[seen, :2] / rays[seen, 2:]
    off = uv[seen] - [camera.cx, camera.cy]
    f = float((q * off).sum() / (q * q).sum())
    return Perspective(f, f, camera.cx, camera.cy, camera.width, camera.height)
