"""Plane-sweep stereo: match scores of a view against others at planes of depth.

Collins, "A Space-Sweep Approach to True Multi-Image Matching", CVPR 1996. Planes are parallel to
the view's image plane, at inverse depths zeta. Pictures are whitened over small windows first, so
that the window mean of a product is a zero-mean normalised cross-correlation: gain and exposure
cancel before the sweep.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera
from calm_edge.types import Bytes, Float, Float32

WHITENING_PX = 7
# Grey levels of noise left after shrinking: damps the correlation of weaker texture.
NOISE = 1.5
# Clips single strong edges, which would dominate their window.
CONTRAST_LIMIT = 2.5
WINDOW_PX = 3
# A plane is not matched with a camera if its depth there is below this share of its depth here.
NEAREST_SHARE = 0.15


@dataclass(frozen=True, slots=True)
class SweepView:
    """View of the sweep: whitened picture (h, w), pinhole camera at its size, T_s_c (4, 4)."""

    white: Float32
    camera: Camera
    T_s_c: Float


def whitened(gray: Bytes | Float32) -> Float32:
    """(h, w) grey levels -> (h, w) with zero mean and unit variance over small windows."""
    size = (WHITENING_PX, WHITENING_PX)
    level = gray.astype(np.float32)
    mean = cv2.GaussianBlur(level, (0, 0), WHITENING_PX / 4)
    centred = level - mean
    variance = cv2.blur(centred * centred, size)
    white = centred / np.sqrt(variance + np.float32(NOISE**2))
    return np.asarray(np.clip(white, -CONTRAST_LIMIT, CONTRAST_LIMIT), np.float32)


def plane_homographies(view: SweepView, other: SweepView, zeta: Float) -> tuple[Float, Float]:
    """Homographies (D, 3, 3) view px -> other px of planes zeta (D,), and z' / z (D,) on the axis.

    The point on a ray r (z = 1) at inverse depth zeta is on the other camera's ray R r + zeta t.
    """
    T_o_v = se3.inverse(other.T_s_c) @ view.T_s_c
    planes = np.broadcast_to(T_o_v[:3, :3], (len(zeta), 3, 3)).copy()
    planes[:, :, 2] += zeta[:, None] * T_o_v[:3, 3]
    H = other.camera.matrix @ planes @ np.linalg.inv(view.camera.matrix)
    return np.asarray(H), np.asarray(planes[:, 2, 2])


def match_scores(
    view: SweepView, others: Sequence[SweepView], zeta: Float, size: tuple[int, int]
) -> Float32:
    """Scores (D, h, w) in [0, 1]: mean correlation of the better half of the others.

    size: (w, h) of the volume, at most that of the pictures. The better half tolerates occlusion
    (Kang, Szeliski and Chai, CVPR 2001). Outside another picture its correlation is 0.
    """
    rows, columns = view.white.shape
    w, h = size
    kept = (len(others) + 1) // 2
    best: NDArray[np.float32] = np.empty((kept, h, w), np.float32)
    volume = np.empty((len(zeta), h, w), np.float32)
    warps = [plane_homographies(view, other, zeta) for other in others]
    warped = np.empty_like(view.white)
    for d in range(len(zeta)):
        best[:] = 0
        for other, (H, ratio) in zip(others, warps, strict=True):
            if ratio[d] < NEAREST_SHARE:
                continue
            cv2.warpPerspective(
                other.white, H[d], (columns, rows), dst=warped,
                flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, borderMode=cv2.BORDER_CONSTANT,
            )  # fmt: skip
            cv2.multiply(warped, view.white, dst=warped)
            small = cv2.resize(warped, size, interpolation=cv2.INTER_AREA)
            _insert(best, cv2.blur(small, (WINDOW_PX, WINDOW_PX)))
        np.mean(best, axis=0, out=volume[d])
    return np.minimum(volume, 1, out=volume)


def _insert(best: NDArray[np.float32], score: NDArray[np.generic]) -> None:
    """Keep the highest scores of each pixel, sorted, in best (k, h, w); score is overwritten."""
    for k in range(len(best)):
        lower = np.minimum(best[k], score)
        np.maximum(best[k], score, out=best[k])
        score = lower
