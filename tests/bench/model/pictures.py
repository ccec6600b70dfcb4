"""Pictures of a textured plane by two cameras, with exact correspondences."""

from __future__ import annotations

import cv2
import numpy as np

from bench.model.truth import PosedDepth
from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera, Perspective
from calm_edge.types import Bytes, Float

SIZE = (320, 200)
DISTANCE = 10.0


def texture(seed: int = 0) -> Bytes:
    """(600, 900) grey, with structure from a few pixels to many."""
    rng = np.random.default_rng(seed)
    out = np.zeros((600, 900))
    for sigma in (1.5, 3, 6, 12):
        noise = cv2.GaussianBlur(rng.normal(size=out.shape), (0, 0), sigma)
        out += noise / noise.std()
    return np.asarray(np.clip(128 + 35 * out, 0, 255), np.uint8)


def view(camera: Camera, T_w_c: Float, plane: Bytes) -> tuple[Bytes, PosedDepth]:
    """The plane z = DISTANCE, 30 px a unit, seen by a camera: its picture and its depth."""
    width, height = SIZE
    v, u = np.mgrid[:height, :width]
    uv = np.stack([u.ravel(), v.ravel()], 1).astype(np.float64)
    ray = camera.back_project(uv, np.ones(len(uv))) @ T_w_c[:3, :3].T
    along = (DISTANCE - T_w_c[2, 3]) / ray[:, 2]
    p_w = T_w_c[:3, 3] + along[:, None] * ray
    place = (p_w[:, :2] * 30 + np.array([450, 300])).astype(np.float32).reshape(height, width, 2)
    gray = cv2.remap(plane, place, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    z = along.astype(np.float32).reshape(height, width)
    return np.asarray(cv2.cvtColor(gray, cv2.COLOR_GRAY2BGR), np.uint8), PosedDepth(
        camera, T_w_c, z
    )


def camera(focal: float = 250.0) -> Camera:
    """A camera of SIZE."""
    return Perspective(focal, focal, (SIZE[0] - 1) / 2, (SIZE[1] - 1) / 2, *SIZE)


def pose(x: float = 0.0, z: float = 0.0, roll_deg: float = 0.0) -> Float:
    """T_w_c (4, 4)."""
    return se3.compose(se3.so3_exp(np.array([0, 0, np.radians(roll_deg)])), np.array([x, 0, z]))
