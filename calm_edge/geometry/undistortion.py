"""Undistortion maps from a camera with distortion to a pinhole camera, and back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from calm_edge.geometry.camera import Camera, Float, Float32, Perspective

# Cosine of the largest angle off the axis at which undistorted values are read, with margin.
_MIN_COSINE = 0.2


@dataclass(frozen=True, slots=True)
class Undistortion:
    """Maps for cv2.remap from a lens's picture to that of a pinhole camera of the same size.

    map_x, map_y: (H, W) px, -1 for invalid pixels.
    """

    lens: Camera
    camera: Perspective
    map_x: Float32
    map_y: Float32

    @property
    def cut(self) -> float:
        """Share of the original picture that is outside the pinhole camera's."""
        pixels = _pixels(self.lens)
        seen = self.camera.project(self.lens.back_project(pixels, np.ones(pixels.shape[:2])))
        size = np.array([self.lens.width, self.lens.height])
        kept = ((seen > -0.5 - 1e-6) & (seen < size - 0.5 + 1e-6)).all(-1)
        return float(1 - kept.mean())

    def picture(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Undistort a picture (H, W) or (H, W, 3); black where the lens shows nothing."""
        return np.asarray(cv2.remap(image, self.map_x, self.map_y, cv2.INTER_AREA), np.uint8)

    def as_taken(self, values: Float32) -> Float32:
        """Values (h, w) of the pixels of the undistorted picture at those of the picture as taken.

        Of any size; 0 outside of the undistorted picture. The nearest are taken: between two depths
        there is nothing.
        """
        h, w = values.shape
        x, y = _places(self.lens, self.camera, w, h)
        return np.asarray(cv2.remap(values, x, y, cv2.INTER_NEAREST), np.float32)


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
    rays = pinhole.rays(_pixels(pinhole))
    uv = np.where(rays[..., 2:] > np.cos(lens.max_angle), lens.project(rays), -1.0)
    map_x, map_y = np.moveaxis(uv.astype(np.float32), -1, 0)
    return Undistortion(lens, pinhole, map_x, map_y)


def undistortions(lenses: Sequence[Camera | None]) -> list[Undistortion | None]:
    """Maps of views by their lenses, computed once a lens; None for a pinhole and for no lens."""
    return [None if lens is None or lens.is_pinhole else _of_lens(lens) for lens in lenses]


@lru_cache(maxsize=8)
def _of_lens(lens: Camera) -> Undistortion:
    return undistortion(lens)


def _pixels(camera: Camera) -> Float:
    """All pixels (H, W, 2) of a camera's picture."""
    across = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    return np.stack(across, -1).astype(np.float64)


@lru_cache(maxsize=8)
def _places(lens: Camera, pinhole: Camera, w: int, h: int) -> Float32:
    """Where the pixels of a lens's picture of w x h px are in the undistorted one: (2, h, w) px."""
    small = [camera.scaled(w / camera.width, h / camera.height) for camera in (lens, pinhole)]
    pixels = np.stack(np.meshgrid(np.arange(w), np.arange(h)), -1).astype(np.float64)
    rays = small[0].rays(pixels)
    seen = (rays[..., 2] > _MIN_COSINE)[..., None]
    there = np.where(seen, small[1].project(np.where(seen, rays, 1.0)), -1.0)
    return np.moveaxis(there.astype(np.float32), -1, 0)
