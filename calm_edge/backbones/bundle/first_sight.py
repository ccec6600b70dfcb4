"""Tracks registered against their first sight, so that they do not drift.

Each step of a track compares two neighbouring pictures, and their small errors add up: of tracks
over ten keyframes a quarter end more than 1 px off. So each step is corrected by comparing the new
picture with the patch around the corner as it was first seen, under an affine warp (Shi and Tomasi,
"Good Features to Track", CVPR 1994) that grows from step to step, and under gain and offset of the
brightness: by the inverse compositional algorithm (Baker and Matthews, "Lucas-Kanade 20 Years On",
IJCV 2004) for all tracks at once.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from calm_edge.geometry.flow import Gray
from calm_edge.types import Float32, Int

RADIUS_PX = 6
ITERATIONS = 5
BLUR_PX = 0.7
# Weight of a pixel: a Gaussian of this sigma, as a share of the radius.
WINDOW_SHARE = 0.6
# Added to the normal equations of the affine part, as a share of the mean of those of translation
# times the squared radius: a patch with little texture keeps its warp.
AFFINE_DAMPING = 0.002
# A correction counts with a correlation of the patches above MIN_CORRELATION, a distance from the
# track below MAX_MOVE_PX, and a zoom since the first sight within ZOOMS.
MIN_CORRELATION = 0.85
MAX_MOVE_PX = 2.5
ZOOMS = (0.3, 4.0)

_AXIS = np.arange(-RADIUS_PX, RADIUS_PX + 1, dtype=np.float32)
_X, _Y = (axis.ravel() for axis in np.meshgrid(_AXIS, _AXIS))
_WEIGHT = np.exp(-(_X**2 + _Y**2) / (2 * (WINDOW_SHARE * RADIUS_PX) ** 2))
_WEIGHT /= _WEIGHT.sum()


class FirstSights:
    """Patches of the current tracks as first seen, and their warps to the newest sight."""

    def __init__(self) -> None:
        pixels = len(_X)
        self._patch = np.zeros((0, pixels), np.float32)
        # from differences of the patches to the step of (translation, affine), (n, 6, pixels)
        self._gain = np.zeros((0, 6, pixels), np.float32)
        self._warp = np.zeros((0, 2, 2), np.float32)

    def add(self, picture: Gray, uv: Float32) -> None:
        """Append tracks that begin at uv (N, 2) px of a picture."""
        if len(uv) == 0:
            return
        warp = np.tile(np.eye(2, dtype=np.float32), (len(uv), 1, 1))
        patch = _sampled(_smooth(picture), uv, warp)
        self._patch = np.concatenate([self._patch, patch])
        self._gain = np.concatenate([self._gain, _gain(patch)])
        self._warp = np.concatenate([self._warp, warp])

    def keep(self, index: Int) -> None:
        """Keep only the tracks at `index` (M,), in its order."""
        self._patch, self._gain = self._patch[index], self._gain[index]
        self._warp = self._warp[index]

    def corrected(self, picture: Gray, uv: Float32) -> tuple[Float32, NDArray[np.bool_]]:
        """Register the tracks, expected at uv (N, 2) px of a picture, against their first sight.

        Returns uv, as it was where that fails, and whether it succeeded (N,).
        """
        if len(uv) == 0:
            return uv, np.zeros(0, bool)
        image, warp, at = _smooth(picture), self._warp, uv
        for _ in range(ITERATIONS):
            difference = _sampled(image, at, warp) - self._patch
            step = (self._gain @ difference[..., None])[..., 0]
            # the warp after the inverse of the step
            warp = warp @ _inverse(np.eye(2, dtype=np.float32) + step[:, 2:].reshape(-1, 2, 2))
            at = at - (warp @ step[:, :2, None])[..., 0]
        correlation = (_sampled(image, at, warp) * self._patch) @ _WEIGHT
        zoom2 = np.linalg.det(warp)
        found = (correlation > MIN_CORRELATION) & (zoom2 > ZOOMS[0] ** 2) & (zoom2 < ZOOMS[1] ** 2)
        found &= np.linalg.norm(at - uv, axis=1) < MAX_MOVE_PX
        self._warp = np.where(found[:, None, None], warp, self._warp)
        return np.where(found[:, None], at, uv), found


def _inverse(A: Float32) -> Float32:
    """Inverses of (N, 2, 2), those of singular matrices not finite."""
    a, b, c, d = A[:, 0, 0], A[:, 0, 1], A[:, 1, 0], A[:, 1, 1]
    adjugate = np.stack([d, -b, -c, a], -1).reshape(-1, 2, 2)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(adjugate / (a * d - b * c)[:, None, None], np.float32)


def _smooth(picture: Gray) -> Float32:
    """The picture (H, W) blurred by BLUR_PX, for derivatives of its patches."""
    return np.asarray(cv2.GaussianBlur(picture.astype(np.float32), (0, 0), BLUR_PX), np.float32)


def _sampled(image: Float32, uv: Float32, warp: Float32) -> Float32:
    """Patches (N, pixels) around uv (N, 2) px under warps (N, 2, 2), of mean 0 and variance 1."""
    x = uv[:, :1] + warp[:, 0, :1] * _X + warp[:, 0, 1:] * _Y
    y = uv[:, 1:] + warp[:, 1, :1] * _X + warp[:, 1, 1:] * _Y
    patch = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    patch -= (patch @ _WEIGHT)[:, None]
    return np.asarray(patch / (np.sqrt(np.square(patch) @ _WEIGHT)[:, None] + 1e-3), np.float32)


def _gain(patch: Float32) -> Float32:
    """H^-1 J^T W (n, 6, pixels) of patches (n, pixels): J by (x, y, the affine part by rows)."""
    side = len(_AXIS)
    square = patch.reshape(-1, side, side)
    slopes = np.zeros((len(patch), 2, side, side), np.float32)
    slopes[:, 0, :, 1:-1] = (square[:, :, 2:] - square[:, :, :-2]) / 2
    slopes[:, 1, 1:-1] = (square[:, 2:] - square[:, :-2]) / 2
    J = np.zeros((len(patch), 6, side * side), np.float32)
    J[:, :2] = slopes.reshape(-1, 2, side * side)
    J[:, 2], J[:, 3] = J[:, 0] * _X, J[:, 0] * _Y
    J[:, 4], J[:, 5] = J[:, 1] * _X, J[:, 1] * _Y
    weighted = J * _WEIGHT
    H = weighted @ np.swapaxes(J, 1, 2)
    texture = H[:, 0, 0] + H[:, 1, 1]
    scale = texture.mean() / 2
    damping = np.array([0, 0, 1, 1, 1, 1], np.float32) * RADIUS_PX**2 * AFFINE_DAMPING * scale
    H = H + np.diag(damping + np.float32(1e-6))
    return np.asarray(np.linalg.inv(H) @ weighted, np.float32)
