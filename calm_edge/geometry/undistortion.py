"""Undistortion maps from a camera with distortion to a pinhole camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calm_edge.geometry.camera import Camera, Float32, Perspective


@dataclass(frozen=True, slots=True)
class Undistortion:
    """Maps for cv2.remap to a pinhole camera. map_x, map_y: (H, W) px, -1 for invalid pixels.

    cut: share of the original image that is outside the pinhole camera's image.
    """

    camera: Perspective
    map_x: Float32
    map_y: Float32
    cut: float


def undistortion(lens: Camera, max_fov_deg: float = 100.0) -> Undistortion:
    """Compute the maps to a pinhole camera with the lens's field of view, at most max_fov_deg.

    Image size, principal point and aspect ratio are those of the lens.
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
