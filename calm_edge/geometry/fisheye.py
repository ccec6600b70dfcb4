"""Fisheye camera model of cv2.fisheye (Kannala and Brandt, 2006)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial import Polynomial

from calm_edge.geometry.camera import (
    LAST_STEP,
    NEWTON_STEPS,
    TABLE_RAD,
    TABLE_REACH,
    Camera,
    Float,
    first_root,
)

MAX_FISHEYE_DEG = 160.0
# Nearer to the axis the quotients by the radius lose their digits.
TINY_RADIUS2 = 1e-8


class FieldTooWide(ValueError):
    """A fisheye lens with a field of view of more than MAX_FISHEYE_DEG."""


@dataclass(frozen=True, slots=True)
class Fisheye(Camera):
    """Camera with image radius f (a + k1 a^3 + k2 a^5 + k3 a^7 + k4 a^9) at angle a off the axis.

    Raises FieldTooWide.
    """

    def __post_init__(self) -> None:
        x, y = [-0.5, self.width - 0.5], [-0.5, self.height - 0.5]
        edges = self.rays(np.array([*((u, self.cy) for u in x), *((self.cx, v) for v in y)]))
        angle = np.fmin(np.arctan2(np.hypot(edges[:, 0], edges[:, 1]), edges[:, 2]), self.max_angle)
        across = np.degrees(max(angle[:2].sum(), angle[2:].sum()))
        if across > MAX_FISHEYE_DEG:
            raise FieldTooWide(
                f"fisheye lens with a field of view of {across:.0f} degrees: "
                f"at most {MAX_FISHEYE_DEG:.0f} are supported"
            )

    @property
    def max_angle(self) -> float:
        return _fisheye_limit(self.distortion)

    def project_jacobian(self, p_c: Float) -> Float:
        rho, angle = _off_axis(p_c)
        radius, slope = _radius(angle, self.distortion), _slope(angle, self.distortion)
        square, gain = rho**2 + p_c[..., 2] ** 2, radius / rho
        bend = (slope * p_c[..., 2] / square - gain) / rho**2
        along = np.concatenate([bend[..., None] * p_c[..., :2], -(slope / square)[..., None]], -1)
        J = p_c[..., :2, None] * along[..., None, :]
        J[..., 0, 0] += gain
        J[..., 1, 1] += gain
        return np.asarray(np.array([[self.fx], [self.fy]]) * J)

    def rays(self, uv: Float) -> Float:
        q = (uv - np.array([self.cx, self.cy])) / np.array([self.fx, self.fy])
        r = np.linalg.norm(q, axis=-1)
        table, angles = _table(self.distortion)
        angle, shown = np.interp(r, table, angles), r < TABLE_REACH * table[-1]
        with np.errstate(all="ignore"):
            for _ in range(NEWTON_STEPS):
                step = (_radius(angle, self.distortion) - r) / _slope(angle, self.distortion)
                angle = angle - step
                if not (np.abs(step[shown]) > LAST_STEP).any():
                    break
            met = np.abs(_radius(angle, self.distortion) - r) < 1e-9
            across = q * (np.sin(angle) / np.maximum(r, 1e-300))[..., None]
        ray = np.concatenate([across, np.cos(angle)[..., None]], -1)
        return np.where((met & (angle < self.max_angle))[..., None], ray, np.nan)

    def normalized(self, uv: Float) -> Float:
        ray = self.rays(uv)
        return np.asarray(ray[..., :2] / ray[..., 2:])

    def _plane(self, p_c: Float) -> Float:
        rho, angle = _off_axis(p_c)
        return np.asarray(p_c[..., :2] * (_radius(angle, self.distortion) / rho)[..., None])

    def _terms(self, p_c: Float) -> Float:
        rho, angle = _off_axis(p_c)
        powers = angle[..., None] ** np.arange(3, 3 + 2 * len(self.distortion), 2) / rho[..., None]
        return np.asarray(p_c[..., :2, None] * powers[..., None, :])


def angle_radial(s: Float, k: Sequence[Float | float]) -> tuple[Float, Float]:
    """Factor (...) from normalised coordinates q to image coordinates, at squared radii s of q.

    And its derivative by s. k: the leading terms k1, k2 ..., each a number, or (...) one a point.
    """
    r = np.sqrt(np.maximum(s, TINY_RADIUS2))
    angle = np.arctan(r)
    square = angle * angle
    bend, slope = np.ones_like(r), np.ones_like(r)
    for n, term in enumerate(k, 1):
        power = term * square**n
        bend += power
        slope += (2 * n + 1) * power
    gain = angle / r * bend
    return gain, (slope / (1 + r * r) - gain) / (2 * r * r)


def angle_terms(s: Float, count: int) -> Float:
    """Derivatives (count, ...) of the factor of `angle_radial` by k1, k2 ..."""
    r = np.sqrt(np.maximum(s, TINY_RADIUS2))
    angle = np.arctan(r)
    return np.stack([angle ** (2 * n + 1) / r for n in range(1, count + 1)])


def _off_axis(p_c: Float) -> tuple[Float, Float]:
    """Distance from the optical axis, bounded away from zero, and angle off it [rad]."""
    z = p_c[..., 2]
    rho = np.hypot(p_c[..., 0], p_c[..., 1])
    rho = np.maximum(rho, 1e-9 * np.maximum(np.abs(z), 1e-9))
    return rho, np.arctan2(rho, z)


def _radius(angle: Float, distortion: tuple[float, ...]) -> Float:
    """Image radius [focal lengths] at angles [rad]."""
    return _even(angle, (1.0, *distortion)) * angle


def _slope(angle: Float, distortion: tuple[float, ...]) -> Float:
    """Derivative of `_radius` by the angle."""
    return _even(angle, [(2 * n + 1) * term for n, term in enumerate((1.0, *distortion))])


def _even(x: Float, terms: Sequence[float]) -> Float:
    """c0 + c1 x^2 + c2 x^4 + ... of the terms c, by Horner's rule."""
    total = np.full(np.shape(x), terms[-1])
    for term in reversed(terms[:-1]):
        total = total * x * x + term
    return total


@lru_cache
def _table(distortion: tuple[float, ...]) -> tuple[Float, Float]:
    """Image radii [focal lengths], increasing, and their angles [rad], below the limit."""
    angles = TABLE_RAD[_fisheye_limit(distortion) > TABLE_RAD]
    return _radius(angles, distortion), angles


@lru_cache
def _fisheye_limit(distortion: tuple[float, ...]) -> float:
    slope = np.zeros(2 * len(distortion) + 1)
    slope[::2] = [(2 * n + 1) * term for n, term in enumerate((1.0, *distortion))]
    return first_root(Polynomial(slope), np.pi / 2)
