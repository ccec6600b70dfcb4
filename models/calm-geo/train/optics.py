"""Where a view's pixels look: its lens, and its pose while one row after the other is exposed.

Of a clip's view: K (3, 3) px; lens (3,): 1 if the fisheye model, then k1 and k2 of that or of the
perspective one; T_w_c (4, 4) of the middle row; motion (6,): twist, m and rad, from the first row's
pose to the last one's, in the camera's axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera, Perspective
from calm_edge.geometry.distortion import radial
from calm_edge.geometry.fisheye import Fisheye, angle_radial

Array = np.ndarray
# the row of a point seen by a rolling shutter is found by so many projections
ROW_ITERATIONS = 4


@dataclass(frozen=True, slots=True)
class Optics:
    """Camera, pose and motion of a view."""

    camera: Camera
    T_w_c: Array
    motion: Array

    @classmethod
    def of(cls, view: Sequence[Array], size: tuple[int, int]) -> Optics:
        """From K, lens, T_w_c, motion of a view of a clip; size: height, width."""
        K, lens, T_w_c, motion = view
        model = Fisheye if lens[0] else Perspective
        terms = tuple(float(k) for k in lens[1:]) if lens.any() else ()
        fx, fy, cx, cy = (float(v) for v in (K[0, 0], K[1, 1], K[0, 2], K[1, 2]))
        camera = model(fx, fy, cx, cy, size[1], size[0], terms)
        return cls(camera, T_w_c.astype(np.float64), motion.astype(np.float64))

    def share(self, row: Array) -> Array:
        """When rows (...) are exposed, in readout times after the middle one."""
        return np.asarray(row / (self.camera.height - 1) - 0.5)

    def poses(self, row: Array) -> Array:
        """T_w_c (N, 4, 4) when rows (N,) are exposed."""
        return np.asarray(self.T_w_c @ se3.exp(self.motion * self.share(row)[:, None]))

    def rays(self) -> Array:
        """(H, W, 3) rays (x, y, 1) of all pixels in the axes of the camera."""
        rows, columns = np.mgrid[0 : self.camera.height, 0 : self.camera.width]
        q = self.camera.normalized(np.stack([columns, rows], -1).astype(np.float64))
        return np.concatenate([q, np.ones_like(q[..., :1])], -1)

    def points(self, uv: Array, depth: Array) -> Array:
        """World points (N, 3) of pixels (N, 2) with z-depths (N,) when their rows are exposed."""
        p_c = self.camera.back_project(uv.astype(np.float64), depth.astype(np.float64))
        T = self.poses(uv[:, 1])
        return np.asarray((T[:, :3, :3] @ p_c[..., None])[..., 0] + T[:, :3, 3])

    def pixels(self, p_w: Array) -> tuple[Array, Array]:
        """Pixels (N, 2) of world points (N, 3) when their rows are exposed, and z-depths (N,).

        NaN where the lens sees no such point.
        """
        row = np.full(len(p_w), (self.camera.height - 1) / 2)
        for _ in range(ROW_ITERATIONS):
            T = se3.inverse(self.poses(row))
            p_c = (T[:, :3, :3] @ p_w[..., None])[..., 0] + T[:, :3, 3]
            seen = self.camera.within_reach(p_c) & (p_c[:, 2] > 0.1)
            uv = np.where(seen[:, None], self.camera.project(p_c), np.nan)
            row = np.clip(np.nan_to_num(uv[:, 1], nan=0.0), 0, self.camera.height - 1)
        return uv, p_c[:, 2]


def drawn_lens(random: np.random.Generator, hfov_deg: float) -> Array:
    """A lens (3,) by lot for an angle of view: none, a webcam's, or, if wide, an angle model."""
    if random.random() < 0.4:
        return np.zeros(3)
    if hfov_deg > 80 and random.random() < 0.7:
        return np.array([1.0, random.uniform(-0.05, 0.03), random.uniform(-0.01, 0.01)])
    # far enough from where the radius folds: by the widest corner of the picture
    corner = (1.2 * np.tan(np.radians(hfov_deg) / 2)) ** 2
    low = max(-0.2, -0.2 / corner)
    return np.array([0.0, random.uniform(low, 0.03), 0.0])


def drawn_camera(
    random: np.random.Generator, hfov_deg: float, size: tuple[int, int]
) -> tuple[Array, Array]:
    """K (3, 3) and lens (3,) by lot whose picture is about hfov_deg across; size: height, width."""
    height, width = size
    lens = drawn_lens(random, hfov_deg)
    tangent = np.tan(np.radians(hfov_deg) / 2)
    bend, _ = (angle_radial if lens[0] else radial)(np.array(tangent**2), lens[1:].tolist())
    focal = width / 2 / float(tangent * bend)
    x, y = random.uniform(-0.02, 0.02, 2) * width
    K = np.array([[focal, 0, (width - 1) / 2 + x], [0, focal, (height - 1) / 2 + y], [0, 0, 1]])
    return K, lens
