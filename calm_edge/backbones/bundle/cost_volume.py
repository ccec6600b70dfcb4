"""Plane-sweep stereo: match scores of a view against others at planes of depth.

Collins, "A Space-Sweep Approach to True Multi-Image Matching", CVPR 1996. Planes are parallel to
the view's image plane, at inverse depths zeta = 1 / z. Pictures are whitened over small windows
first, so that the window mean of a product is a zero-mean normalised cross-correlation: gain and
exposure cancel before the sweep.
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
# Sigma of noise [grey levels] in the reduced pictures: texture weaker than it correlates less.
NOISE = 1.5
# Whitened values are clipped to +- this: else a single strong edge would dominate its window.
CONTRAST_LIMIT = 2.5
WINDOW_PX = 3
# A plane is not matched with another view if, at its point on this view's axis, the z-depth in the
# other view is below this share of that in this one.
NEAREST_SHARE = 0.15


@dataclass(frozen=True, slots=True)
class SweepView:
    """View of the sweep: picture (h, w) from `whitened`, pinhole camera of this size, and pose.

    T_s_c: (4, 4) camera to sub-map, spacings.
    """

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
    """Homographies (D, 3, 3) of D planes, from pixels of `view` to `other`, and z' / z (D,).

    zeta: (D,) inverse depths in `view`. z' / z: depth in `other` over depth in `view` of the point
    of each plane on the axis of `view`. A point on the ray r (z = 1) of `view` at inverse depth
    zeta is on the ray R r + zeta t of `other`, with R, t of T_other_view.
    """
    T_o_v = se3.inverse(other.T_s_c) @ view.T_s_c
    planes = np.broadcast_to(T_o_v[:3, :3], (len(zeta), 3, 3)).copy()
    planes[:, :, 2] += zeta[:, None] * T_o_v[:3, 3]
    H = other.camera.matrix @ planes @ np.linalg.inv(view.camera.matrix)
    return np.asarray(H), np.asarray(planes[:, 2, 2])


def match_scores(
    view: SweepView,
    others: Sequence[SweepView],
    zeta: Float,
    size: tuple[int, int],
    first: Float32 | None = None,
) -> Float32:
    """Scores (D, h, w) in [0, 1] of the view's pixels at D planes of inverse depths zeta (D,).

    The mean of the correlations with the better half of the other views: tolerates occlusion (Kang,
    Szeliski and Chai, CVPR 2001). Outside another view's picture its correlation is 0. size: (w, h)
    of the result, at most that of the pictures. first: (D, h, w), takes the correlations with the
    first of the others alone.
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
        for k, (other, (H, ratio)) in enumerate(zip(others, warps, strict=True)):
            if ratio[d] < NEAREST_SHARE:
                continue
            cv2.warpPerspective(
                other.white, H[d], (columns, rows), dst=warped,
                flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, borderMode=cv2.BORDER_CONSTANT,
            )  # fmt: skip
            cv2.multiply(warped, view.white, dst=warped)
            small = cv2.resize(warped, size, interpolation=cv2.INTER_AREA)
            score = cv2.blur(small, (WINDOW_PX, WINDOW_PX))
            if first is not None and k == 0:
                first[d] = score
            _insert(best, score)
        np.mean(best, axis=0, out=volume[d])
    return np.minimum(volume, 1, out=volume)


def _insert(best: NDArray[np.float32], score: NDArray[np.generic]) -> None:
    """Insert one view's scores (h, w) into best (k, h, w): each pixel's k highest, sorted."""
    for k in range(len(best)):
        lower = np.minimum(best[k], score)
        np.maximum(best[k], score, out=best[k])
        score = lower
