"""Fundamental matrices from matches, with their uncertainty.

F: (3, 3) px, `x_b^T F x_a = 0` for homogeneous pixels of views a and b; unit Frobenius norm.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera

Float = NDArray[np.float64]
Bool = NDArray[np.bool_]

# F has seven degrees of freedom; one more match is needed to estimate the noise
MIN_MATCHES = 8
_REFINEMENTS = 4
_HUBER = 1.5
# variance of a unit normal clipped at _HUBER
_CLIPPED_VARIANCE = 0.778
# lower bound of a match's sigma, so that exact synthetic matches do not give zero uncertainty
_NOISE_FLOOR_PX = 0.05
_GENERATORS = se3.hat(np.eye(3))


@dataclass(frozen=True, slots=True)
class Fundamental:
    """A fundamental matrix F (3, 3) of rank 2 and its uncertainty.

    steps: (7, 3, 3) one-sigma changes of F along independent directions. inliers: (M,) mask of
    the matches used.
    """

    F: Float
    steps: Float
    inliers: Bool


def homogeneous(uv: Float) -> Float:
    """Homogeneous coordinates (..., 3) of pixels (..., 2)."""
    uv = np.asarray(uv, np.float64)
    return np.concatenate([uv, np.ones((*uv.shape[:-1], 1))], -1)


def from_motion(a: Camera, b: Camera, T_b_a: Float) -> Float:
    """F (..., 3, 3) of two cameras, ignoring distortion, and a relative pose (..., 4, 4)."""
    E = se3.hat(T_b_a[..., :3, 3]) @ T_b_a[..., :3, :3]
    F = np.linalg.inv(b.matrix).T @ E @ np.linalg.inv(a.matrix)
    return np.asarray(F / np.linalg.norm(F, axis=(-2, -1), keepdims=True))


def sampson(F: Float, uv_a: Float, uv_b: Float) -> Float:
    """Signed Sampson distances (M,) px of matches (M, 2) for F (3, 3).

    First-order geometric error: Hartley and Zisserman, "Multiple View Geometry", 2004, 11.4.3.
    """
    value, gradient = _algebraic(F, homogeneous(uv_a), homogeneous(uv_b))
    return np.asarray(value / np.maximum(np.linalg.norm(gradient, axis=1), 1e-300))


def fundamental(
    uv_a: Float, uv_b: Float, threshold_px: float = 1.0, iterations: int = 500, seed: int = 0
) -> Fundamental | None:
    """Estimate F from matches (M, 2) px with outliers by MAGSAC, then `refine`.

    None with too few inliers. seed: of the random samples. See cv2.findFundamentalMat and
    cv2.UsacParams.
    """
    if len(uv_a) < MIN_MATCHES:
        return None
    params = cv2.UsacParams()
    params.sampler = cv2.SAMPLING_UNIFORM
    params.score = cv2.SCORE_METHOD_MAGSAC
    params.loMethod = cv2.LOCAL_OPTIM_INNER_LO
    params.final_polisher = cv2.LSQ_POLISHER
    params.confidence, params.maxIterations = 0.999, iterations
    params.threshold, params.randomGeneratorState = threshold_px, seed
    a, b = np.ascontiguousarray(uv_a, np.float64), np.ascontiguousarray(uv_b, np.float64)
    try:
        F, _ = cv2.findFundamentalMat(a, b, params)
    except cv2.error:
        return None
    if F is None or F.shape != (3, 3) or not np.isfinite(F).all() or not F.any():
        return None
    return refine(np.asarray(F, np.float64), a, b, threshold_px)


def refine(F: Float, uv_a: Float, uv_b: Float, threshold_px: float = 1.0) -> Fundamental | None:
    """Refine F by Gauss-Newton on the Sampson distances of its inliers among matches (M, 2) px.

    Rank 2 is kept by the parametrisation: two rotations and the ratio of the singular values
    (Bartoli and Sturm, 2004). None with fewer than MIN_MATCHES inliers, or if these do not
    determine F.
    """
    unit_px = max(float(np.hypot(uv_a.std(), uv_b.std())), 1e-9)
    to_a, x_a = _normalised(uv_a, unit_px)
    to_b, x_b = _normalised(uv_b, unit_px)
    inliers = np.abs(sampson(F, uv_a, uv_b)) < threshold_px
    normal = np.linalg.inv(to_b).T @ F @ np.linalg.inv(to_a)
    H, noise = np.zeros((7, 7)), 0.0
    for _ in range(_REFINEMENTS):
        if inliers.sum() < MIN_MATCHES:
            return None
        normal, tangent = _tangent(normal)
        residual, J = _linearised(normal, tangent, x_a[inliers], x_b[inliers])
        sigma = max(float(np.median(np.abs(residual))) / 0.6745, _NOISE_FLOOR_PX / unit_px)
        weight = np.minimum(1.0, _HUBER * sigma / np.maximum(np.abs(residual), 1e-300))
        clipped = float(((weight * residual) ** 2).sum()) / _CLIPPED_VARIANCE
        noise = np.sqrt(clipped / max(len(residual) - 7, 1))
        H = J.T @ (weight[:, None] * J)
        try:
            step = -np.linalg.solve(H, J.T @ (weight * residual))
        except np.linalg.LinAlgError:
            return None
        normal = normal + np.einsum("k,kij->ij", step, tangent)
        inliers = np.abs(sampson(to_b.T @ normal @ to_a, uv_a, uv_b)) < threshold_px
    normal, tangent = _tangent(normal)
    noise_px = max(float(noise) * unit_px, _NOISE_FLOOR_PX)
    values, vectors = np.linalg.eigh(H)
    if inliers.sum() < MIN_MATCHES or values[0] <= 1e-12 * values[-1]:
        return None
    one_sigma = vectors / np.sqrt(values) * noise_px / unit_px
    F = to_b.T @ normal @ to_a
    steps = to_b.T @ np.einsum("kj,kab->jab", one_sigma, tangent) @ to_a
    size = np.linalg.norm(F)
    return Fundamental(F / size, steps / size, inliers)


def _normalised(uv: Float, unit_px: float) -> tuple[Float, Float]:
    """Centre pixels (M, 2) and divide by unit_px: the transform (3, 3) and the result (M, 3)."""
    x, y = -uv.mean(0) / unit_px
    to = np.array([[1 / unit_px, 0, x], [0, 1 / unit_px, y], [0, 0, 1]])
    return to, homogeneous(uv) @ to.T


def _tangent(F: Float) -> tuple[Float, Float]:
    """F (3, 3) projected to rank 2 and unit norm, and its tangent directions (7, 3, 3)."""
    U, s, Vt = np.linalg.svd(F)
    s = np.array([s[0], s[1], 0.0]) / np.hypot(s[0], s[1])
    left = U @ _GENERATORS @ np.diag(s) @ Vt
    right = U @ np.diag(s) @ _GENERATORS @ Vt
    ratio = U @ np.diag([-s[1], s[0], 0.0]) @ Vt
    return U @ np.diag(s) @ Vt, np.concatenate([left, right, ratio[None]])


def _algebraic(F: Float, x_a: Float, x_b: Float) -> tuple[Float, Float]:
    """Algebraic errors x_b^T F x_a (M,) and derivatives (M, 4) by the pixel coordinates."""
    line_b, line_a = x_a @ F.T, x_b @ F
    return (x_b * line_b).sum(1), np.concatenate([line_b[:, :2], line_a[:, :2]], 1)


def _linearised(F: Float, tangent: Float, x_a: Float, x_b: Float) -> tuple[Float, Float]:
    """Sampson distances (M,) and derivatives (M, 7) along the tangent directions (7, 3, 3)."""
    value, gradient = _algebraic(F, x_a, x_b)
    size = np.maximum(np.linalg.norm(gradient, axis=1), 1e-300)
    line_b = np.einsum("kij,mj->mki", tangent, x_a)
    line_a = np.einsum("kij,mi->mkj", tangent, x_b)
    d_value = np.einsum("mki,mi->mk", line_b, x_b)
    d_size = line_b[..., :2] @ gradient[:, :2, None] + line_a[..., :2] @ gradient[:, 2:, None]
    return value / size, d_value / size[:, None] - (value / size**3)[:, None] * d_size[..., 0]
