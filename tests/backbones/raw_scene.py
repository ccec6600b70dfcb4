"""Scene from which raw network outputs are computed, independently of the decoders."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calm_edge.geometry.camera import Camera
from calm_edge.types import Float


def turn(axis: int, degrees: float) -> Float:
    """Rotation matrix (3, 3) about a coordinate axis."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    R = np.eye(3)
    R[i, i] = R[j, j] = c
    R[i, j], R[j, i] = -s, s
    return R


@dataclass(frozen=True)
class RawScene:
    """Views of the plane normal . p = distance in the world. K: (N, 3, 3) px of the images.

    T_w_c: (N, 4, 4), all different in every axis, none the identity.
    """

    K: Float
    T_w_c: Float
    sizes: list[tuple[int, int]]
    normal: Float
    distance: float

    def ray(self, view: int, u: Float, v: Float) -> Float:
        """Rays (..., 3), z = 1, camera axes, through pixels of the image."""
        K = self.K[view]
        y = (v - K[1, 2]) / K[1, 1]
        return np.stack([(u - K[0, 2]) / K[0, 0], y, np.ones_like(y)], -1)

    def z(self, view: int, u: Float, v: Float) -> Float:
        """z-depth at pixels of the image."""
        ray_w = self.ray(view, u, v) @ self.T_w_c[view, :3, :3].T
        gap = self.distance - self.T_w_c[view, :3, 3] @ self.normal
        return np.asarray(gap / (ray_w @ self.normal))

    def T_s_c(self) -> Float:
        """The expected decoded T_s_c."""
        return np.linalg.inv(self.T_w_c[0]) @ self.T_w_c


def matrices(cameras: Sequence[Camera]) -> Float:
    """(N, 3, 3) px."""
    return np.array([camera.matrix for camera in cameras])


def make_scene(sizes: list[tuple[int, int]], offset_px: tuple[float, float] = (0, 0)) -> RawScene:
    """A scene with a view per size. offset_px: of the principal points from the image centres."""
    K, T_w_c = [], []
    for view, (width, height) in enumerate(sizes):
        fx, fy = (0.8 + 0.05 * view) * width, (0.75 + 0.05 * view) * width
        cx, cy = (width - 1) / 2 + offset_px[0], (height - 1) / 2 + offset_px[1]
        K.append([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        T = np.eye(4)
        T[:3, :3] = turn(0, 3 + 2 * view) @ turn(1, 8 - 7 * view) @ turn(2, 2 + 5 * view)
        T[:3, 3] = 0.3 + 0.4 * view, -0.2 + 0.1 * view, 0.5 - 0.3 * view
        T_w_c.append(T)
    normal = np.array([0.2, 0.1, 1.0]) / np.linalg.norm([0.2, 0.1, 1.0])
    return RawScene(np.array(K), np.array(T_w_c), sizes, normal, 9.0)
