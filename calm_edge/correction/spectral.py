"""Score of intrinsics K on fundamental matrices F (Eq. Score, paper V-A), and its sensitivity.

With the true K, E = K^T F K has two equal singular values and one that is zero. The score is the
deviation from that, so 0 is perfect and less is better.
K: (..., 3, 3) px, F: (..., 3, 3) px as in `geometry.epipolar`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calm_edge.geometry.camera import Camera
from calm_edge.types import Float

# steps of numeric derivatives: of log focal, and in sigmas of F
_STEP = 1e-3
_SIGMAS = 1e-2
# a slope below this many of its sigmas counts as zero; five, because its noise has heavy tails for
# motions that do not determine the focal
_SIGNIFICANT = 5.0
# lower bound of the score's noise, so that exact synthetic matrices have finite information
_SCORE_FLOOR = 1e-4
# Sigma of the principal point's offset from the image centre, as a share of the width; assumed
# (the largest seen in our recordings is 2.6 %).
PRINCIPAL_POINT_SHARE = 0.007


@dataclass(frozen=True, slots=True)
class FocalSensitivity:
    """Sensitivity of the scores of P matrices at G focals.

    log_focal: (G,) of px, ascending. curves: (5, P, G): derivative of the score near its minimum
    by log focal; sigma of the score and of that derivative due to noise of the matches; change of
    the score for one sigma of the principal point, in x and in y.
    """

    log_focal: Float
    curves: Float

    def at(self, log_focal: float) -> Float:
        """Interpolate the curves (5, P) at a log focal [log px]."""
        x = float(np.interp(log_focal, self.log_focal, np.arange(len(self.log_focal))))
        low = min(int(x), len(self.log_focal) - 2)
        share = x - low
        return np.asarray((1 - share) * self.curves[..., low] + share * self.curves[..., low + 1])


def score(K: Float, F: Float) -> Float:
    """Error of K as |s1 - s2| / s1 + |s3| / s1, s the singular values of K^T F K, (..., P).

    K: (..., 3, 3) candidates, F: (P, 3, 3). Computed from the eigenvalues of E E^T in closed form
    (accurate to 1e-6), because hundreds of matrices are scored for dozens of candidates.
    """
    a, b, c = _rows(K[..., None, :, :], np.ascontiguousarray(np.moveaxis(F, 0, -1)))
    aa, bb, cc = (a * a).sum(0), (b * b).sum(0), (c * c).sum(0)
    ab, ac, bc = (a * b).sum(0), (a * c).sum(0), (b * c).sum(0)
    mean = np.maximum((aa + bb + cc) / 3, 1e-300)
    aa, bb, cc = aa / mean - 1, bb / mean - 1, cc / mean - 1
    ab, ac, bc = ab / mean, ac / mean, bc / mean
    radius2 = (aa * aa + bb * bb + cc * cc + 2 * (ab * ab + ac * ac + bc * bc)) / 6
    radius = np.sqrt(np.maximum(radius2, 1e-300))
    det = aa * (bb * cc - bc * bc) - ab * (ab * cc - bc * ac) + ac * (ab * bc - bb * ac)
    angle = np.arccos(np.clip(det / (2 * radius**3), -1, 1)) / 3
    s1 = np.sqrt(1 + 2 * radius * np.cos(angle))
    s2 = np.sqrt(np.maximum(1 + 2 * radius * np.cos(angle - 2 * np.pi / 3), 0))
    s3 = np.sqrt(np.maximum(1 + 2 * radius * np.cos(angle + 2 * np.pi / 3), 0))
    return np.asarray((s1 - s2 + s3) / s1)


def at_focal(shape: Camera, focal: Float | float) -> Float:
    """K (..., 3, 3) px with focals (...), and aspect ratio and principal point of `shape`."""
    focal = np.asarray(focal, np.float64)
    K = np.broadcast_to(shape.matrix, (*focal.shape, 3, 3)).copy()
    K[..., 0, 0], K[..., 1, 1] = focal, focal * shape.fy / shape.fx
    return K


def score_at(shape: Camera, focal: Float | float, F: Float) -> Float:
    """Scores (..., P) of focals (...) px on F (P, 3, 3), least is best; rest of K from `shape`."""
    return score(at_focal(shape, focal), F)


def score_of(cameras: Sequence[Camera], F: Float) -> Float:
    """Scores (C, P) of C cameras on F (P, 3, 3); the least is the best."""
    return score(np.stack([camera.matrix for camera in cameras]), F)


def focal_sensitivity(shape: Camera, F: Float, steps: Float, focals: Float) -> FocalSensitivity:
    """Sensitivity of F (P, 3, 3) with one-sigma steps (P, 7, 3, 3) at focals (G,) px, ascending.

    shape: aspect ratio and principal point. The derivative is zero for motion on a straight line
    and on an arc tangent to the optical axis, where every focal explains the matrix.
    """
    log_focal = np.log(focals)
    K, above, below = (at_focal(shape, np.exp(log_focal + d)) for d in (0.0, _STEP, -_STEP))
    base = F[:, None, None]
    plane = np.linalg.svd(_essential(K, base))[0][..., :2]
    near = [base + sign * _SIGMAS * steps[:, :, None] for sign in (1, -1)]

    def slope(F: Float) -> Float:
        return (_asymmetry(above, F, plane) - _asymmetry(below, F, plane)) / (2 * _STEP)

    def off_centre(axis: int) -> Float:
        moved = np.zeros((3, 3))
        moved[axis, 2] = PRINCIPAL_POINT_SHARE * 2 * shape.cx
        return (_asymmetry(K + moved, base, plane) - _asymmetry(K - moved, base, plane)) / 2

    by_focal = slope(base)
    size = np.linalg.norm(by_focal, axis=-1)
    along = by_focal / np.maximum(size, 1e-300)[..., None]
    noise = (_asymmetry(K, near[0], plane) - _asymmetry(K, near[1], plane)) / (2 * _SIGMAS)
    slope_noise = (slope(near[0]) - slope(near[1])) / (2 * _SIGMAS)
    curves = [
        size[:, 0],
        # of the two components, the one along the slope has on average half of the variance
        np.sqrt((noise**2).sum((1, 3)) / 2),
        np.sqrt((slope_noise**2).sum((1, 3))),
        *((off_centre(axis) * along).sum(-1)[:, 0] for axis in (0, 1)),
    ]
    return FocalSensitivity(log_focal, np.stack(curves))


def information(sensitivity: FocalSensitivity, log_focal: float, model_noise: float = 0.0) -> Float:
    """Information (P,) on the log focal: (slope / noise)^2, 0 for an insignificant slope.

    model_noise: sigma of the score due to other errors (lens distortion, moving objects). The
    uncertainty of the principal point is included in the noise.
    """
    slope, noise, slope_noise, by_cx, by_cy = sensitivity.at(log_focal)
    counts = slope > _SIGNIFICANT * slope_noise
    variance = noise**2 + by_cx**2 + by_cy**2 + model_noise**2 + _SCORE_FLOOR**2
    return np.asarray(counts * slope**2 / variance)


def centre_shift(sensitivity: FocalSensitivity, log_focal: float) -> Float:
    """Shift (P, 2) of the log focal of least score for one sigma of the principal point x, y."""
    slope, _, _, by_cx, by_cy = sensitivity.at(log_focal)
    return np.asarray(-np.stack([by_cx, by_cy], -1) / np.maximum(slope, 1e-300)[:, None])


def _essential(K: Float, F: Float) -> Float:
    return np.asarray(np.swapaxes(K, -1, -2) @ F @ K)


def _rows(K: Float, F: Float) -> tuple[Float, Float, Float]:
    """Rows, each (3, ..., P), of K^T F K for K (..., 1, 3, 3) and F (3, 3, P).

    Written out for upper triangular K, since numpy's product of many 3 x 3 matrices is slow.
    """
    fx, skew, cx, fy, cy = (K[..., i, j] for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2)))
    right = [
        np.stack([f[0] * fx, f[0] * skew + f[1] * fy, f[0] * cx + f[1] * cy + f[2]]) for f in F
    ]
    return (
        fx * right[0],
        skew * right[0] + fy * right[1],
        cx * right[0] + cy * right[1] + right[2],
    )


def _asymmetry(K: Float, F: Float, plane: Float) -> Float:
    """Deviation (..., 2) of E E^T, restricted to `plane`, from a multiple of the identity.

    plane: (..., 3, 2) orthonormal basis orthogonal to the left null vector. The norm of the result
    is the score to first order; unlike the score it is differentiable where that is zero.
    """
    G = np.swapaxes(plane, -1, -2) @ _essential(K, F)
    x, y = G[..., 0, :], G[..., 1, :]
    xx, yy, xy = (x * x).sum(-1), (y * y).sum(-1), (x * y).sum(-1)
    return np.asarray(np.stack([xx - yy, 2 * xy], -1) / (xx + yy)[..., None])
