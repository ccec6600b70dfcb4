"""How well intrinsics explain fundamental matrices, and how much of that these can tell (V-A).

E = K^T F K of the true intrinsics has two equal singular values and a zero. K: (..., 3, 3) px,
F: (..., 3, 3) px as in `geometry.epipolar`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calm_edge.geometry.camera import Camera
from calm_edge.types import Float

# for derivatives: of log focal, and of each of a matrix's own sigmas
_STEP = 1e-3
_SIGMAS = 1e-2
# how many of its own sigmas a slope must measure to count: five, since noise in a turn on which
# the score is blind comes with tails
_SIGNIFICANT = 5.0
# the smallest score told from zero; keeps exact synthetic matrices finite
_SCORE_FLOOR = 1e-4
# Principal points are guessed at the image centre; real ones lie off it by about this share of the
# width (one sigma, assumed: 2.6 % in the worst recording at hand).
PRINCIPAL_POINT_SHARE = 0.007


@dataclass(frozen=True, slots=True)
class Telling:
    """What each of P matrices can tell of focal, at G focals.

    log_focal: (G,) of px, growing. curves: (5, P, G) of the score beside its minimum: slope by
    log focal; noise, slope's noise (one sigma of the matches' noise); what one sigma of the
    principal point, across and down, adds along the slope.
    """

    log_focal: Float
    curves: Float

    def at(self, log_focal: float) -> Float:
        """The curves (5, P) at the focal [log px], interpolated."""
        x = float(np.interp(log_focal, self.log_focal, np.arange(len(self.log_focal))))
        low = min(int(x), len(self.log_focal) - 2)
        share = x - low
        return np.asarray((1 - share) * self.curves[..., low] + share * self.curves[..., low + 1])


def score(K: Float, F: Float) -> Float:
    """Eq. Score, paper V-A: |s1 - s2| / s1 + |s3| / s1 of K^T F K, (..., P).

    K: (..., 3, 3) candidates, F: (P, 3, 3). The eigenvalues of E E^T come in closed form, good to
    1e-6: hundreds of matrices under dozens of candidates then cost milliseconds.
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
    """K (..., 3, 3) px of focals (...), with the aspect and principal point of `shape`."""
    focal = np.asarray(focal, np.float64)
    K = np.broadcast_to(shape.matrix, (*focal.shape, 3, 3)).copy()
    K[..., 0, 0], K[..., 1, 1] = focal, focal * shape.fy / shape.fx
    return K


def score_at(shape: Camera, focal: Float | float, F: Float) -> Float:
    """Eq. Score of F (P, 3, 3) at focals (...) px of `shape`: (..., P)."""
    return score(at_focal(shape, focal), F)


def score_of(cameras: Sequence[Camera], F: Float) -> Float:
    """Eq. Score of F (P, 3, 3) for each of the cameras: (C, P)."""
    return score(np.stack([camera.matrix for camera in cameras]), F)


def telling(shape: Camera, F: Float, steps: Float, focals: Float) -> Telling:
    """What F (P, 3, 3) with one-sigma steps (P, 7, 3, 3) can tell at focals (G,) px, growing.

    shape: has the aspect and principal point. A slope of zero, on a straight or on an arc
    the optical axis is tangent to, means that every focal explains the matrix equally well.
    """
    log_focal = np.log(focals)
    K, above, below = (at_focal(shape, np.exp(log_focal + d)) for d in (0.0, _STEP, -_STEP))
    base = F[:, None, None]
    plane = np.linalg.svd(_essential(K, base))[0][..., :2]
    near = [base + sign * _SIGMAS * steps[:, :, None] for sign in (1, -1)]

    def slope(F: Float) -> Float:
        return (_asymmetry(above, F, plane) - _asymmetry(below, F, plane)) / (2 * _STEP)

    def aside(axis: int) -> Float:
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
        # half of it lies along the slope, on average
        np.sqrt((noise**2).sum((1, 3)) / 2),
        np.sqrt((slope_noise**2).sum((1, 3))),
        *((aside(axis) * along).sum(-1)[:, 0] for axis in (0, 1)),
    ]
    return Telling(log_focal, np.stack(curves))


def information(told: Telling, log_focal: float, model_noise: float = 0.0) -> Float:
    """(P,) information on log focal: (slope / noise)^2, 0 where the slope is itself but noise.

    model_noise: of the score, what neither the matches' noise nor the focal explains (lens,
    moving things). The principal point's uncertainty counts as noise too.
    """
    slope, noise, slope_noise, across, down = told.at(log_focal)
    counts = slope > _SIGNIFICANT * slope_noise
    variance = noise**2 + across**2 + down**2 + model_noise**2 + _SCORE_FLOOR**2
    return np.asarray(counts * slope**2 / variance)


def pull(told: Telling, log_focal: float) -> Float:
    """(P, 2) how far one sigma of the principal point, across and down, moves the log focal."""
    slope, _, _, across, down = told.at(log_focal)
    return np.asarray(-np.stack([across, down], -1) / np.maximum(slope, 1e-300)[:, None])


def _essential(K: Float, F: Float) -> Float:
    return np.asarray(np.swapaxes(K, -1, -2) @ F @ K)


def _rows(K: Float, F: Float) -> tuple[Float, Float, Float]:
    """The rows, each (3, ..., P), of K^T F K for K (..., 1, 3, 3) and F (3, 3, P).

    Written out, since K is triangular and numpy multiplies many 3 x 3 matrices slowly.
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
    """The two ways (..., 2) in which E E^T is not a multiple of the identity on `plane`.

    plane: (..., 3, 2) orthonormal, across the left null vector. To first order the length of the
    result is the score; unlike the score it is smooth where that is zero.
    """
    G = np.swapaxes(plane, -1, -2) @ _essential(K, F)
    x, y = G[..., 0, :], G[..., 1, :]
    xx, yy, xy = (x * x).sum(-1), (y * y).sum(-1), (x * y).sum(-1)
    return np.asarray(np.stack([xx - yy, 2 * xy], -1) / (xx + yy)[..., None])
