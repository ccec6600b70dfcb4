"""A textured wall seen by a moving camera: exact images of an exact geometry."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from calm_edge.geometry import se3
from calm_edge.geometry.camera import Perspective
from calm_edge.geometry.flow import corners
from calm_edge.types import (
    Bytes,
    Float,
    Float32,
    Landmarks,
    LocalizerUpdate,
    Metre,
    Prediction,
    Submap,
    Trajectory,
)

WIDTH, HEIGHT = 480, 240
CAMERA = Perspective.from_hfov(80.0, WIDTH, HEIGHT)
DEPTH = 10.0
PIXELS_A_METRE = 40.0
TEXTURE_SIZE = 2400


def texture(seed: int = 0) -> Bytes:
    rng = np.random.default_rng(seed)
    coarse = rng.integers(0, 255, (150, 150), np.uint8)
    fine = rng.integers(0, 255, (600, 600), np.uint8)
    size = (TEXTURE_SIZE, TEXTURE_SIZE)
    mixed = cv2.addWeighted(
        cv2.resize(coarse, size, interpolation=cv2.INTER_CUBIC),
        0.6,
        cv2.resize(fine, size, interpolation=cv2.INTER_CUBIC),
        0.4,
        0,
    )
    return np.asarray(mixed, np.uint8)


class PlaneWorld:
    """The wall z = DEPTH, with the texture centred on the z axis."""

    def __init__(self, seed: int = 0) -> None:
        self.texture = texture(seed)

    def render(self, T_w_c: Float) -> Bytes:
        T_c_w = se3.inverse(T_w_c)
        half = (TEXTURE_SIZE - 1) / 2
        # texture pixel -> metres on the wall
        A = np.array(
            [
                [1 / PIXELS_A_METRE, 0, -half / PIXELS_A_METRE],
                [0, 1 / PIXELS_A_METRE, -half / PIXELS_A_METRE],
                [0, 0, 1.0],
            ]
        )
        plane = np.stack([T_c_w[:3, 0], T_c_w[:3, 1], T_c_w[:3, 2] * DEPTH + T_c_w[:3, 3]], 1)
        H = CAMERA.matrix @ plane @ A
        return np.asarray(cv2.warpPerspective(self.texture, H, (WIDTH, HEIGHT)), np.uint8)

    def depth_at(self, T_w_c: Float, uv: Float) -> Float:
        """z-depth (M,) of the wall at pixels (M, 2)."""
        ray = CAMERA.back_project(uv, np.ones(len(uv)))
        return np.asarray((DEPTH - T_w_c[2, 3]) / (ray @ T_w_c[2, :3]))

    def update(
        self,
        submap_id: int,
        ids: Sequence[int],
        t_ns: Sequence[int],
        T_w_c: Float,
        *,
        raw_scale: float = 0.5,
        T_map_world: Float | None = None,
        with_depth: bool = False,
        scale_log_sigma: float = 0.01,
    ) -> LocalizerUpdate:
        """Update of a perfect estimator for keyframes `ids` at T_w_c (N, 4, 4).

        T_map_world: the estimator's world may lie elsewhere than ours.
        """
        T_map_world = np.eye(4) if T_map_world is None else T_map_world
        T_s_c = se3.inverse(T_w_c[0]) @ T_w_c
        raw = T_s_c.copy()
        raw[:, :3, 3] /= raw_scale
        points, index, view, uv = [], [], [], []
        for i, T in enumerate(T_w_c):
            px = corners(self.render(T), 250).astype(np.float64)
            p_c = CAMERA.back_project(px, self.depth_at(T, px))
            points.append(se3.transform(T_s_c[i], p_c) / raw_scale)
            index.append(np.arange(len(px)) + sum(len(p) for p in points[:-1]))
            view.append(np.full(len(px), i))
            uv.append(px)
        landmarks = Landmarks(
            np.concatenate(points),
            np.concatenate(index),
            np.concatenate(view),
            np.concatenate(uv).astype(np.float32),
        )
        n = len(ids)
        depth: Float32 | None = None
        if with_depth:
            grid = np.stack(np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT)), -1)
            flat = grid.reshape(-1, 2).astype(np.float64)
            true = np.stack([self.depth_at(T, flat).reshape(HEIGHT, WIDTH) for T in T_w_c])
            depth = (true / raw_scale).astype(np.float32)
        covariance = np.kron(np.diag(np.arange(n)), np.diag([1e-6] * 3 + [1e-8] * 3))
        prediction = Prediction(
            (CAMERA,) * n,
            raw,
            depth=depth,
            landmarks=None if with_depth else landmarks,
            covariance=covariance.astype(np.float32),
        )
        stamps = np.array(t_ns, np.int64)
        submap = Submap(
            submap_id,
            tuple(ids),
            (),
            0,
            stamps,
            raw,
            (CAMERA,) * n,
            T_s_c,
            (CAMERA,) * n,
            raw_scale,
            T_map_world @ T_w_c[0],
            np.zeros(2),
            scale_log_sigma=scale_log_sigma,
        )
        trajectory = Trajectory(np.array(ids, np.int64), stamps, T_map_world @ T_w_c, np.eye(4), 0)
        return LocalizerUpdate(submap, prediction, trajectory, metre=Metre(0.01))


def drive(n: int, step_m: float = 0.1, yaw_deg: float = 0.0) -> Float:
    """Poses (n, 4, 4) moving right along the wall and slightly towards it, turning by yaw."""
    i = np.arange(n)[:, None]
    xi = np.zeros((n, 6))
    xi[:, 0:1], xi[:, 2:3], xi[:, 4:5] = i * step_m, i * step_m * 0.3, np.radians(yaw_deg) * i
    return np.asarray(
        se3.compose(se3.so3_exp(xi[:, 3:]), xi[:, :3] - np.array([n * step_m / 2, 0, 0]))
    )
