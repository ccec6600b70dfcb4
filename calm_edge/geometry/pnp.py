"""Camera pose from 3-D points and their pixels (PnP), with covariance."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera

Float = NDArray[np.float64]
Float32 = NDArray[np.float32]

HUBER_PX = 1.0
ITERATIONS = 10
# Lower bound of the residuals' sigma: localisation noise of a well-defined corner.
NOISE_FLOOR_PX = 0.2
NEAREST_DEPTH = 1e-3


@dataclass(frozen=True, slots=True)
class PoseFit:
    """Estimated pose T_w_c (4, 4). covariance: (6, 6) of (translation, rotation), camera axes.

    inlier: (M,) mask.
    """

    T_w_c: Float
    covariance: Float
    inlier: NDArray[np.bool_]

    @property
    def n_inliers(self) -> int:
        return int(self.inlier.sum())


def reprojection(camera: Camera, p_w: Float, T_w_c: Float) -> tuple[Float, Float]:
    """Project world points (M, 3) to pixels (M, 2), inf if invisible, and camera points (M, 3)."""
    p_c = se3.transform(se3.inverse(T_w_c), p_w)
    uv = camera.project(p_c)
    uv[(p_c[:, 2] < NEAREST_DEPTH) | ~camera.within_reach(p_c)] = np.inf
    return uv, p_c


def refine(
    camera: Camera, p_w: Float, uv: Float32, T_w_c: Float, threshold_px: float
) -> PoseFit | None:
    """Refine a pose by Gauss-Newton with Huber weights; None if the points do not determine it.

    p_w: (M, 3). uv: (M, 2) px. T_w_c: initial pose. Inliers have residuals below threshold_px.
    The covariance is the inverse Hessian times the mean squared residual of the inliers.
    """
    if len(p_w) < 6:
        return None
    for _ in range(ITERATIONS):
        seen, p_c = reprojection(camera, p_w, T_w_c)
        front = np.isfinite(seen).all(1)
        if front.sum() < 6:
            return None
        residual = (uv - seen)[front]
        size = np.linalg.norm(residual, axis=1)
        weight = np.minimum(1.0, HUBER_PX / np.maximum(size, 1e-9))
        weight[size > 10 * threshold_px] = 0.0
        J = _jacobian(camera, p_c[front])
        H = np.einsum("nij,n,nik->jk", J, weight, J)
        g = np.einsum("nij,n,ni->j", J, weight, residual)
        try:
            step = np.linalg.solve(H, g)
        except np.linalg.LinAlgError:
            return None
        if not np.isfinite(step).all():
            return None
        T_w_c = T_w_c @ se3.exp(step)
        if np.linalg.norm(step) < 1e-9:
            break
    # orthonormalise, since poses are predicted from earlier ones and rounding would accumulate
    T_w_c = se3.compose(se3.so3_exp(se3.so3_log(T_w_c[:3, :3])), T_w_c[:3, 3])
    seen, p_c = reprojection(camera, p_w, T_w_c)
    size = np.linalg.norm(uv - seen, axis=1)
    inlier = size < threshold_px
    if inlier.sum() < 6:
        return None
    J = _jacobian(camera, p_c[inlier])
    variance = max(float(np.mean(size[inlier] ** 2)) / 2, NOISE_FLOOR_PX**2)
    H = np.einsum("nij,nik->jk", J, J)
    if np.linalg.cond(H) > 1e14:
        return None
    return PoseFit(T_w_c, np.asarray(np.linalg.inv(H) * variance), inlier)


def _jacobian(camera: Camera, p_c: Float) -> Float:
    """Derivative (M, 2, 6) of pixels by xi = (rho, w) of T_w_c exp(xi): dp_c = -rho + [p_c]x w."""
    d_uv = camera.project_jacobian(p_c)
    return np.asarray(np.concatenate([-d_uv, d_uv @ se3.hat(p_c)], -1))


def locate(
    camera: Camera, p_w: Float, uv: Float32, T_w_c: Float, threshold_px: float
) -> PoseFit | None:
    """Estimate the pose from a predicted T_w_c, or by RANSAC if that has under 60 % inliers.

    See cv2.solvePnPRansac, whose random seed is fixed. None if neither succeeds.
    """
    fit = refine(camera, p_w, uv, T_w_c, threshold_px)
    if fit is not None and fit.n_inliers >= 0.6 * len(p_w):
        return fit
    if len(p_w) < 6:
        return None
    straight = camera.undistorted(uv.astype(np.float64))
    found, rotation, translation, _ = cv2.solvePnPRansac(
        p_w, straight, camera.matrix, None, iterationsCount=200, reprojectionError=threshold_px
    )
    if not found:
        return fit
    R = np.asarray(cv2.Rodrigues(rotation)[0], np.float64)
    T_c_w = se3.compose(R, np.asarray(translation, np.float64)[:, 0])
    other = refine(camera, p_w, uv, se3.inverse(T_c_w), threshold_px)
    if other is None or (fit is not None and fit.n_inliers >= other.n_inliers):
        return fit
    return other
