"""A small rendered sequence folder with ground truth, for the scripted backbone."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from calm_edge.geometry import se3
from calm_edge.types import Float
from tests.frontend.plane_world import CAMERA, PlaneWorld, drive

SPACING_M = 0.5
ASSISTANT_DELAY_S = 0.017


def poses(n: int) -> Float:
    """Poses T_w_p (n, 4, 4) of the primary, starting at the origin."""
    T = drive(n, 0.12)
    return np.asarray(se3.inverse(T[0]) @ T)


def write_drive(folder: Path, n: int = 40, spacing_m: float = SPACING_M) -> Path:
    """Write `n` frames per eye at 10 Hz, the assistant 17 ms later, as a sequence folder."""
    world = PlaneWorld()
    T_w_p, T_p_a = poses(n), se3.exp(np.array([spacing_m, 0, 0, 0, 0.02, 0]))
    at = np.arange(n, dtype=np.float64)
    late = se3.interpolate_at(at, T_w_p, at + ASSISTANT_DELAY_S * 10)
    T_start = drive(n, 0.12)[0]
    for eye, T_w_c in enumerate((T_w_p, late @ T_p_a)):
        images = folder / f"cam{eye}"
        images.mkdir(parents=True)
        for i, T in enumerate(T_w_c):
            gray = world.render(T_start @ T)
            cv2.imwrite(str(images / f"{i:06d}.jpg"), cv2.merge([gray, gray, gray]))
        stamps = np.arange(n) * 0.1 + eye * ASSISTANT_DELAY_S
        np.savetxt(folder / f"times{eye}.txt", stamps, fmt="%.6f")
    np.savetxt(folder / "poses0.txt", T_w_p[:, :3].reshape(-1, 12))
    np.savetxt(folder / "T_p_a.txt", T_p_a[:3].reshape(1, 12))
    camera = CAMERA
    row = [camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height]
    np.savetxt(folder / "calib.txt", [row, row])
    return folder
