"""The map from a lens's picture to a pinhole camera's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calm_edge.geometry.camera import Camera, Float32, Perspective


@dataclass(frozen=True, slots=True)
class Undistortion:
    """Maps (H, W) float32 px for cv2.remap into `camera`'s picture, -1 where the lens has none.

    cut: share of the lens's pixels that lie outside `camera`'s picture.
    """

    camera: Perspective
    map_x: Float32
    map_y: Float32
    cut: float


def undistortion(lens: Camera, max_fov_deg: float = 100.0) -> Undistortion:
    """The map to a pinhole camera as wide as the lens, max_fov_deg across at most.

    It has the lens's picture size, centre and ratio of focals.
    """
    size = lens.width, lens.height
    sides = np.array([-0.5, lens.width - 0.5])
    ray = lens.rays(np.stack([sides, np.full(2, lens.cy)], -1))
    angle = np.fmin(np.arctan2(np.abs(ray[:, 0]), ray[:, 2]), lens.max_angle)
    reach = np.tan(np.minimum(angle, np.radians(max_fov_deg) / 2))
    fx = float(np.max(np.abs(sides - lens.cx) / reach))
    pinhole = Perspective(fx, fx * lens.fy / lens.fx, lens.cx, lens.cy, *size)
    pixels = np.stack(np.meshgrid(*map(np.arange, size)), -1).astype(np.float64)
    rays = pinhole.rays(pixels)
    uv = np.where(rays[..., 2:] > np.cos(lens.max_angle), lens.project(rays), -1.0)
    seen = pinhole.project(lens.back_project(pixels, np.ones(pixels.shape[:2])))
    kept = ((seen > -0.5 - 1e-6) & (seen < np.array(size) - 0.5 + 1e-6)).all(-1)
    map_x, map_y = np.moveaxis(uv.astype(np.float32), -1, 0)
    return Undistortion(pinhole, map_x, map_y, float(1 - kept.mean()))
