"""Pictures of a textured road under an even sky, seen from given poses, with exact truth."""

from __future__ import annotations

import cv2
import numpy as np

from calm_edge.geometry import se3

HEIGHT = 2.5  # of the cameras above the road, in spacings
CELL = 0.05  # of the texture
EXTENT = 60.0


def asphalt(seed: int = 3):
    """Texture of grains of several sizes."""
    rng = np.random.default_rng(seed)
    n = int(2 * EXTENT / CELL)
    grains = [
        cv2.GaussianBlur(rng.normal(size=(n, n)).astype(np.float32), (0, 0), s) for s in (1, 3, 7)
    ]
    return 110 + sum(14 * grain / grain.std() for grain in grains)


def kerb(period: float = 1.5):
    """Texture of stripes across the road, each like the next."""
    z = np.arange(-EXTENT, EXTENT, CELL)
    return np.tile(
        np.where((z // (period / 2)) % 2, 160.0, 60.0).astype(np.float32)[:, None], (1, len(z))
    )


def smooth():
    """A road without texture."""
    n = int(2 * EXTENT / CELL)
    return np.full((n, n), 110, np.float32)


def picture(texture, T_s_c, camera, noise=1.0, seed=0):
    """Picture (H, W) uint8 of the road y = HEIGHT of the sub-map's axes."""
    uv = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), -1)
    rays = camera.rays(uv.reshape(-1, 2).astype(float)) @ T_s_c[:3, :3].T
    down = rays[:, 1]
    reach = np.where(down > 1e-3, (HEIGHT - T_s_c[1, 3]) / np.maximum(down, 1e-3), np.nan)
    ground = T_s_c[:3, 3] + rays * reach[:, None]
    at = ((ground[:, [0, 2]] + EXTENT) / CELL).astype(np.float32)
    at = np.where(np.isfinite(at), at, -1).reshape(*uv.shape)
    shown = cv2.remap(texture, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderValue=200)
    shown += np.random.default_rng(seed).normal(size=shown.shape) * noise
    return np.clip(shown, 0, 255).astype(np.uint8)


def drive(n: int, step: float = 2.5, yaw: float = 0.02):
    """T_s_c (n, 4, 4): along z, turning about y."""
    twist = np.array([0.0, 0.0, step, 0.0, yaw, 0.0])
    T = [np.eye(4)]
    for _ in range(n - 1):
        T.append(T[-1] @ se3.exp(twist))
    return np.array(T)
