"""Projection of lens models that `geometry/camera` does not have.

Each takes camera points (..., 3) and returns distorted image coordinates (..., 2) in focal lengths;
NaN where the model has no image.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from calm_edge.geometry.camera import Perspective
from calm_edge.types import Float

Plane = Callable[[Float], Float]
# fx, fy, cx, cy [px]
Pinhole = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class Lens:
    """A lens of any model. plane: as in this module. Other entries as of `Camera`."""

    plane: Plane
    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int

    def project(self, p_c: Float) -> Float:
        """Project camera points (..., 3) to pixels (..., 2)."""
        return np.asarray(self.plane(p_c) * [self.fx, self.fy] + [self.cx, self.cy])


def unified(xi: float, k: Sequence[float] = ()) -> Plane:
    """Unified model with OpenCV's radial and tangential distortion k (Mei and Rives, ICRA 2007)."""
    lens = Perspective(1.0, 1.0, 0.0, 0.0, 1, 1, tuple(k))

    def plane(p_c: Float) -> Float:
        length = np.linalg.norm(p_c, axis=-1)
        z = p_c[..., 2] + xi * length
        # only points in front of the plane that is tangent to the projection are seen
        seen = z > max(xi - 1 / max(xi, 1e-9), 0.0) * length
        q = np.stack([p_c[..., 0], p_c[..., 1], np.where(seen, z, np.nan)], -1)
        return lens.project(q)

    return plane


def double_sphere(xi: float, alpha: float) -> Plane:
    """Double sphere model (Usenko et al., 3DV 2018, Eq. 40 to 45)."""
    w1 = alpha / (1 - alpha) if alpha <= 0.5 else (1 - alpha) / alpha
    w2 = (w1 + xi) / np.sqrt(2 * w1 * xi + xi * xi + 1)

    def plane(p_c: Float) -> Float:
        d1 = np.linalg.norm(p_c, axis=-1)
        shifted = xi * d1 + p_c[..., 2]
        d2 = np.sqrt(p_c[..., 0] ** 2 + p_c[..., 1] ** 2 + shifted**2)
        return _over(p_c, alpha * d2 + (1 - alpha) * shifted, p_c[..., 2] > -w2 * d1)

    return plane


def extended_unified(alpha: float, beta: float) -> Plane:
    """Extended unified model (Khomutenko et al., RA-L 2016)."""

    def plane(p_c: Float) -> Float:
        d = np.sqrt(beta * (p_c[..., 0] ** 2 + p_c[..., 1] ** 2) + p_c[..., 2] ** 2)
        w = alpha / (1 - alpha) if alpha <= 0.5 else (1 - alpha) / alpha
        return _over(p_c, alpha * d + (1 - alpha) * p_c[..., 2], p_c[..., 2] > -w * d)

    return plane


def field_of_view(omega: float) -> Plane:
    """FOV model (Devernay and Faugeras, 2001): r_d = atan(2 r tan(omega / 2)) / omega."""

    def plane(p_c: Float) -> Float:
        q = _normalised(p_c)
        r = np.maximum(np.linalg.norm(q, axis=-1, keepdims=True), 1e-9)
        return np.asarray(q * np.arctan(2 * r * np.tan(omega / 2)) / (r * omega))

    return plane


def division(k: float) -> Plane:
    """Division model (Fitzgibbon, CVPR 2001): r = r_d / (1 + k r_d^2)."""

    def plane(p_c: Float) -> Float:
        q = _normalised(p_c)
        inner = 1 - 4 * k * (q**2).sum(-1, keepdims=True)
        return np.asarray(2 * q / (1 + np.sqrt(np.where(inner >= 0, inner, np.nan))))

    return plane


def thin_prism_fisheye(k: Sequence[float]) -> Plane:
    """COLMAP's THIN_PRISM_FISHEYE, on angle coordinates. k: k1, k2, p1, p2, k3, k4, sx1, sy1."""
    k1, k2, p1, p2, k3, k4, sx1, sy1 = k

    def plane(p_c: Float) -> Float:
        q = _angle_coordinates(p_c)
        x, y = q[..., 0], q[..., 1]
        s = x * x + y * y
        gain = 1 + s * (k1 + s * (k2 + s * (k3 + s * k4)))
        return np.stack(
            [
                gain * x + 2 * p1 * x * y + p2 * (s + 2 * x * x) + sx1 * s,
                gain * y + 2 * p2 * x * y + p1 * (s + 2 * y * y) + sy1 * s,
            ],
            -1,
        )

    return plane


def rad_tan_thin_prism_fisheye(k: Sequence[float]) -> Plane:
    """COLMAP's RAD_TAN_THIN_PRISM_FISHEYE. k: k0 ... k5, applied first, p0, p1, s0 ... s3."""
    radial, (p0, p1), s = np.array([1.0, *k[:6]]), k[6:8], k[8:]

    def plane(p_c: Float) -> Float:
        q = _angle_coordinates(p_c)
        q = q * np.polynomial.polynomial.polyval((q**2).sum(-1, keepdims=True), radial)
        x, y = q[..., 0], q[..., 1]
        r2 = x * x + y * y
        along = 2 * (p0 * x + p1 * y)
        return np.stack(
            [
                x * (1 + along) + r2 * (p0 + s[0] + s[1] * r2),
                y * (1 + along) + r2 * (p1 + s[2] + s[3] * r2),
            ],
            -1,
        )

    return plane


def brown_with_prism(k: Sequence[float]) -> Plane:
    """OpenCV's perspective model with thin prism and tilt: 12 or 14 coefficients."""
    terms, zero = np.array(k, np.float64), np.zeros(3)

    def plane(p_c: Float) -> Float:
        ahead = np.where(p_c[..., 2:] > 1e-3, p_c, np.nan).reshape(-1, 1, 3)
        uv = cv2.projectPoints(ahead, zero, zero, np.eye(3), terms)[0]
        return np.asarray(uv.reshape(*p_c.shape[:-1], 2))

    return plane


def _over(p_c: Float, denominator: Float, seen: np.ndarray) -> Float:
    good = seen & (denominator > 1e-9)
    return np.asarray(p_c[..., :2] / np.where(good, denominator, np.nan)[..., None])


def _normalised(p_c: Float) -> Float:
    """x / z, y / z; NaN behind the camera."""
    z = p_c[..., 2:]
    return np.asarray(p_c[..., :2] / np.where(z > 1e-3, z, np.nan))


def _angle_coordinates(p_c: Float) -> Float:
    """The direction in the picture times the angle off the axis [rad]."""
    rho = np.linalg.norm(p_c[..., :2], axis=-1, keepdims=True)
    return np.asarray(p_c[..., :2] * np.arctan2(rho, p_c[..., 2:]) / np.maximum(rho, 1e-12))
