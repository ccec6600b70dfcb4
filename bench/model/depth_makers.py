"""Classical depth of posed pictures: semi-global matching of a pair, and bundle's plane sweep."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import cv2
import numpy as np

from bench.model.described import gray_of
from bench.model.protocols import DepthMaker
from calm_edge.backbones.bundle.depth import sweep_window
from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera, Perspective
from calm_edge.types import Bytes, Float, Float32, Hints, Int, Prediction

# Smallest depth searched, in distances between the cameras.
NEAREST_SPACINGS = 4.0
BLOCK_PX, UNIQUENESS = 5, 10
CONSISTENT_PX = 1.0
STEP_NS = 100_000_000


def partner(T_w_c: Float, eyes: Int, reference: int) -> int:
    """Index of the view of the other eye whose camera centre is nearest to the reference view's."""
    other = np.flatnonzero(eyes != eyes[reference])
    away = np.linalg.norm(T_w_c[other, :3, 3] - T_w_c[reference, :3, 3], axis=1)
    return int(other[away.argmin()])


class SgbmDepth:
    """OpenCV's StereoSGBM on one picture of each eye, rectified by the given cameras and poses.

    Confidence falls with the difference between left and right disparity. Beyond CONSISTENT_PX the
    depth is 0.
    """

    def depth(
        self,
        images: Sequence[Bytes],
        cameras: Sequence[Camera],
        T_w_c: Float,
        eyes: Int,
        reference: int,
    ) -> tuple[Float32, Float32]:
        """Compute the depth, see DepthMaker.

        0 everywhere if the cameras are one above the other instead of side by side.
        """
        other = partner(T_w_c, eyes, reference)
        a, b = gray_of(images[reference]), gray_of(images[other])
        size = (a.shape[1], a.shape[0])
        T = se3.inverse(T_w_c[other]) @ T_w_c[reference]
        none, (K_a, K_b) = np.zeros(5), (cameras[i].matrix for i in (reference, other))
        T_columns = T[:3, 3].reshape(3, 1)
        found = cv2.stereoRectify(
            K_a, none, K_b, none, size, T[:3, :3], T_columns,
            flags=cv2.CALIB_ZERO_DISPARITY, alpha=-1,
        )  # fmt: skip
        R_a, R_b, P_a, P_b = (np.asarray(m, np.float64) for m in found[:4])
        shift = float(P_b[0, 3])  # disparity times depth, negative if the reference is the left eye
        if abs(P_b[1, 3]) > abs(shift):
            return np.zeros(a.shape, np.float32), np.zeros(a.shape, np.float32)
        flat_a, flat_b = (
            _rectified(g, k, R, P, size) for g, k, R, P in ((a, K_a, R_a, P_a), (b, K_b, R_b, P_b))
        )
        nearest = NEAREST_SPACINGS * float(np.linalg.norm(T[:3, 3]))
        most = max(16, int(np.ceil(abs(shift) / nearest / 16)) * 16)
        if shift > 0:  # mirrored, the right eye becomes the left one
            flat_a, flat_b = flat_a[:, ::-1], flat_b[:, ::-1]
        disparity, off = _consistent(flat_a, flat_b, most)
        if shift > 0:
            disparity, off = disparity[:, ::-1], off[:, ::-1]
        z = np.where(disparity > 0, abs(shift) / np.maximum(disparity, 1e-6), 0)
        return _brought_back(z, off, cameras[reference], R_a, Perspective.from_matrix(P_a, *size))


def _rectified(gray: Bytes, K: Float, R: Float, P: Float, size: tuple[int, int]) -> Bytes:
    where = cv2.initUndistortRectifyMap(K, np.zeros(5), R, P, size, cv2.CV_32FC1)
    return np.asarray(cv2.remap(gray, *where, cv2.INTER_LINEAR), np.uint8)


def _consistent(left: Bytes, right: Bytes, most: int) -> tuple[Float32, Float32]:
    """Disparity (h, w) of the left picture after the left-right check, 0 if unknown.

    Also returns its difference (h, w) from the right picture's disparity, px. most: number of
    disparities.
    """
    ahead = _disparity(left, right, most)
    # mirrored, the right picture becomes the left one
    back = _disparity(right[:, ::-1], left[:, ::-1], most)[:, ::-1]
    x = np.arange(left.shape[1], dtype=np.float32)[None] - ahead
    y = np.broadcast_to(np.arange(left.shape[0], dtype=np.float32)[:, None], x.shape)
    there = cv2.remap(
        np.ascontiguousarray(back), x, np.ascontiguousarray(y), cv2.INTER_NEAREST,
        borderMode=cv2.BORDER_CONSTANT, borderValue=-1e3,
    )  # fmt: skip
    off = np.abs(there - ahead)
    known = (ahead > 0) & (there > 0) & (off <= CONSISTENT_PX)
    disparity = np.where(known, ahead, 0).astype(np.float32)
    return disparity, np.where(known, off, 1e3).astype(np.float32)


def _disparity(left: Bytes, right: Bytes, most: int) -> Float32:
    matcher = cv2.StereoSGBM.create(
        minDisparity=0, numDisparities=most, blockSize=BLOCK_PX, P1=8 * BLOCK_PX**2,
        P2=32 * BLOCK_PX**2, uniquenessRatio=UNIQUENESS, speckleWindowSize=100, speckleRange=2,
        mode=cv2.STEREO_SGBM_MODE_SGBM,
    )  # fmt: skip
    # StereoSGBM computes no disparity in the first `most` columns: pad them
    pad = [cv2.copyMakeBorder(p, 0, 0, most, 0, cv2.BORDER_REPLICATE) for p in (left, right)]
    return np.asarray(matcher.compute(*pad)[:, most:] / 16, np.float32)


def _brought_back(
    z: Float, off: Float32, camera: Camera, R: Float, rectified: Camera
) -> tuple[Float32, Float32]:
    """Resample depth (h, w) of a rectified camera to its original camera.

    off: (h, w) left-right differences, px. R: original -> rectified. Returns z-depth (h, w) and
    confidence (h, w).
    """
    height, width = z.shape
    v, u = np.mgrid[:height, :width]
    uv = np.stack([u, v], -1).astype(np.float64)
    ray = camera.back_project(uv, np.ones((height, width))) @ R.T
    at = rectified.project(ray).astype(np.float32)
    here, apart = (
        cv2.remap(
            np.ascontiguousarray(m, np.float32), at[..., 0], at[..., 1], cv2.INTER_NEAREST,
            borderMode=cv2.BORDER_CONSTANT, borderValue=0.0,
        )
        for m in (z, off)
    )  # fmt: skip
    depth = (here / ray[..., 2]).astype(np.float32)
    return depth, np.where(depth > 0, 1 / (1 + apart), 0).astype(np.float32)


class SweepDepth:
    """The plane sweep of bundle, with the given cameras and poses."""

    def depth(
        self,
        images: Sequence[Bytes],
        cameras: Sequence[Camera],
        T_w_c: Float,
        eyes: Int,
        reference: int,
    ) -> tuple[Float32, Float32]:
        """Compute the depth, see DepthMaker."""
        other = partner(T_w_c, eyes, reference)
        spacing = float(np.linalg.norm(T_w_c[other, :3, 3] - T_w_c[reference, :3, 3]))
        T_s_c = se3.inverse(T_w_c[reference]) @ T_w_c
        T_s_c[:, :3, 3] /= spacing
        count = np.array([int((eyes[:k] == eyes[k]).sum()) for k in range(len(eyes))])
        hints = Hints(np.asarray(eyes, np.int64), count * STEP_NS)
        depth, confidence = sweep_window(images, hints, Prediction(tuple(cameras), T_s_c))
        return depth[reference] * np.float32(spacing), confidence[reference]


MAKERS: dict[str, Callable[[], DepthMaker]] = {"SGBM": SgbmDepth, "plane sweep": SweepDepth}
