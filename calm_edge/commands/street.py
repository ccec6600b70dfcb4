"""Rendered drive through a street: a sequence folder for measuring the speed of a computer.

Ground, two fronts and their ends, textured by noise of several sizes; two cameras side by side
drive a bend in it.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from calm_edge.geometry import se3
from calm_edge.geometry.camera import Perspective
from calm_edge.types import Bytes, Float
from device.frame import jpeg

HFOV_DEG, SPACING_M = 80.0, 0.5
SPEED_M_S, TURN_DEG_S = 8.0, 4.0
# walls in axes of the first view [m]: left and right, above and ground, behind and ahead
STREET_M = ((-7.0, 6.0), (-30.0, 1.3), (-20.0, 120.0))
TEXTURE_PX, PX_A_METRE = 1024, 40.0
# sizes of the noise in px of the texture, and its share
NOISE = ((64, 0.5), (16, 0.3), (4, 0.2))
# pictures are rendered at this share of their size
REDUCTION = 2


def write_street(folder: Path, frames: int, rate_hz: float, size: tuple[int, int]) -> None:
    """Write cam0, cam1 and their times. size: width, height [px] of the pictures."""
    small = size[0] // REDUCTION, size[1] // REDUCTION
    camera, texture = Perspective.from_hfov(HFOV_DEG, *small), _texture()
    rig = np.eye(4)
    rig[0, 3] = SPACING_M
    step = np.eye(4)
    step[:3, :3] = se3.so3_exp(np.array([0.0, np.radians(TURN_DEG_S) / rate_hz, 0.0]))
    step[2, 3] = SPEED_M_S / rate_hz
    times = "".join(f"{k / rate_hz:.6f}\n" for k in range(frames))
    for eye, T_p_c in enumerate((np.eye(4), rig)):
        (folder / f"cam{eye}").mkdir(parents=True)
        (folder / f"times{eye}.txt").write_text(times)
        T_w_p = np.eye(4)
        for k in range(frames):
            gray = cv2.resize(_rendered(camera, texture, T_w_p @ T_p_c), size)
            bgr = np.asarray(cv2.cvtColor(gray, cv2.COLOR_GRAY2BGR), np.uint8)
            (folder / f"cam{eye}" / f"{k:06d}.jpg").write_bytes(jpeg(bgr))
            T_w_p = T_w_p @ step


def _texture() -> Bytes:
    rng = np.random.default_rng(0)
    shape = (TEXTURE_PX, TEXTURE_PX)
    mixed = np.zeros(shape, np.float32)
    for size, share in NOISE:
        noise = rng.uniform(0, 255, (TEXTURE_PX // size,) * 2).astype(np.float32)
        mixed += share * cv2.resize(noise, shape, interpolation=cv2.INTER_CUBIC)
    return np.asarray(np.clip(mixed, 0, 255), np.uint8)


def _rendered(camera: Perspective, texture: Bytes, T_w_c: Float) -> Bytes:
    """The street (H, W) grey as seen from T_w_c, which lies in it.

    A ray from inside meets the walls in its direction; the first of them is seen.
    """
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float32)
    flat = [(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)]
    ray = np.tensordot(T_w_c[:3, :3].astype(np.float32), np.stack(flat), 1)
    at = T_w_c[:3, 3].astype(np.float32)[:, None, None]
    walls = np.array(STREET_M, np.float32)[:, :, None, None]
    # one that is parallel to walls never meets these
    ray[ray == 0] = 1e-9
    far = (np.where(ray > 0, walls[:, 1], walls[:, 0]) - at) / ray
    axis = far.argmin(0)
    point = at + ray * far.min(0)
    across = np.where(axis == 0, point[2], point[0])
    # an offset for each pair of walls, so that their textures differ
    along = np.where(axis == 1, point[2], point[1]) + 5 * axis
    x, y = ((PX_A_METRE * part % TEXTURE_PX).astype(np.float32) for part in (across, along))
    return np.asarray(cv2.remap(texture, x, y, cv2.INTER_LINEAR, None, cv2.BORDER_WRAP), np.uint8)
