"""Camera models: projection of points in camera axes (x right, y down, z forward) and its inverse.

Pixels: the centre of the top-left one is (0, 0). `Perspective` is OpenCV's pinhole model with
distortion (calib3d); `geometry/fisheye.py` has the fisheye model, `geometry/through_lens.py` that
of models that are given undistorted pictures. Unlike cv2.undistortPoints, the
inverses also converge near 90 degrees off the axis.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Self

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from calm_edge.geometry.distortion import distorted, distorted_jacobian, radial, term_jacobian

Float = NDArray[np.float64]
Float32 = NDArray[np.float32]
Int = NDArray[np.int64]

# inverse of the distortion: most Newton iterations, initialised from a table over the angle; the
# last step [normalised coordinates, rad], but for pixels farther out than the table by this factor
NEWTON_STEPS, LAST_STEP, TABLE_REACH = 8, 1e-12, 1.01
# angle off the axis up to which `within_reach` holds for a camera without a limit
MAX_REACH_RAD = np.radians(89.99)
TABLE_RAD = np.radians(np.linspace(0.0, 89.9, 1000))


@dataclass(frozen=True, slots=True)
class Camera(ABC):
    """Focal lengths, principal point, image size [px] and distortion coefficients."""

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int
    distortion: tuple[float, ...] = ()

    @property
    @abstractmethod
    def max_angle(self) -> float:
        """Validity limit: largest angle off the axis [rad] where the image radius increases."""

    @abstractmethod
    def project_jacobian(self, p_c: Float) -> Float:
        """Derivative (..., 2, 3) of `project` by camera points (..., 3)."""

    @abstractmethod
    def rays(self, uv: Float) -> Float:
        """Unit bearing vectors (..., 3) of pixels (..., 2); NaN as in `normalized`."""

    @abstractmethod
    def normalized(self, uv: Float) -> Float:
        """Normalised coordinates x/z, y/z of pixels (..., 2); NaN if none are within max_angle."""

    @abstractmethod
    def _plane(self, p_c: Float) -> Float:
        """Distorted image coordinates (..., 2) of points (..., 3), in focal lengths."""

    @abstractmethod
    def _terms(self, p_c: Float) -> Float:
        """Derivative (..., 2, n) of `_plane` by the distortion coefficients."""

    @property
    def is_pinhole(self) -> bool:
        """Whether the camera is fully described by `matrix`."""
        return False

    @property
    def matrix(self) -> Float:
        """Intrinsic matrix K (3, 3) px, without the distortion."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1.0]])

    @property
    def pinhole(self) -> Perspective:
        """The camera without its distortion."""
        return Perspective(self.fx, self.fy, self.cx, self.cy, self.width, self.height)

    @property
    def standard(self) -> Camera:
        """The camera in a model that other programs know: perspective or fisheye."""
        return self

    def project(self, p_c: Float) -> Float:
        """Project camera points (..., 3) to pixels (..., 2); invalid beyond max_angle."""
        q = self._plane(p_c)
        return np.stack([self.fx * q[..., 0] + self.cx, self.fy * q[..., 1] + self.cy], -1)

    def within_reach(self, p_c: Float) -> NDArray[np.bool_]:
        """Whether camera points (..., 3) are within max_angle, where `project` is valid."""
        reach = float(np.tan(min(self.max_angle, MAX_REACH_RAD)))
        out: NDArray[np.bool_] = np.hypot(p_c[..., 0], p_c[..., 1]) < reach * p_c[..., 2]
        return out

    def parameter_jacobian(self, p_c: Float) -> Float:
        """Derivative (..., 2, P) of `project` by P parameters: fx, fy, cx, cy, distortion..."""
        q = self._plane(p_c)
        J = np.zeros((*q.shape, 4 + len(self.distortion)))
        J[..., 0, 0], J[..., 1, 1] = q[..., 0], q[..., 1]
        J[..., 0, 2] = J[..., 1, 3] = 1
        if self.distortion:
            J[..., 4:] = np.array([[self.fx], [self.fy]]) * self._terms(p_c)
        return J

    def rays_jacobian(self, uv: Float) -> Float:
        """Derivative (..., 3, 2) of `rays` by pixels (..., 2).

        It is the pseudo-inverse of `project_jacobian`, whose null space is the ray itself, so that
        the derivative is tangent to the unit sphere.
        """
        return np.asarray(np.linalg.pinv(self.project_jacobian(self.rays(uv))))

    def back_project(self, uv: Float, depth: Float) -> Float:
        """Back-project pixels (..., 2) with z-depths (...) to camera points (..., 3)."""
        x, y = np.moveaxis(self.normalized(uv), -1, 0)
        return np.stack([x * depth, y * depth, np.broadcast_to(depth, x.shape)], -1)

    def undistorted(self, uv: Float) -> Float:
        """Undistort pixels (..., 2): their positions for the pinhole camera `matrix`."""
        if self.is_pinhole:
            return uv
        return np.asarray(self.normalized(uv) * [self.fx, self.fy] + [self.cx, self.cy])

    def pixel_grid(self, columns: int, rows: int) -> Float:
        """Pixels (columns * rows, 2) that cover the picture from corner to corner, row by row."""
        x, y = np.linspace(0, self.width - 1.0, columns), np.linspace(0, self.height - 1.0, rows)
        return np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)

    def with_focal(self, focal: float) -> Self:
        """The camera with another focal length fx [px] and the same aspect ratio."""
        return replace(self, fx=focal, fy=focal * self.fy / self.fx)

    def scaled(self, sx: float, sy: float) -> Self:
        """The camera of the image resized by sx, sy, with the pixel convention of cv2.resize."""
        K = np.array([[sx, 0, (sx - 1) / 2], [0, sy, (sy - 1) / 2], [0, 0, 1.0]]) @ self.matrix
        size = round(self.width * sx), round(self.height * sy)
        return type(self)(*_entries(K), *size, self.distortion)


@dataclass(frozen=True, slots=True)
class Perspective(Camera):
    """Pinhole camera with OpenCV's distortion: the leading terms of (k1, k2, p1, p2, k3 ... k6)."""

    @classmethod
    def from_hfov(cls, hfov_deg: float, width: int, height: int) -> Perspective:
        """Pinhole camera of a horizontal field of view, principal point at the image centre."""
        f = float(width / 2 / np.tan(np.radians(hfov_deg) / 2))
        return cls(f, f, (width - 1) / 2, (height - 1) / 2, width, height)

    @classmethod
    def from_matrix(cls, K: Float, width: int, height: int) -> Perspective:
        """Pinhole camera of K (3, 3) px; skew is ignored."""
        return cls(*_entries(K), width, height)

    @property
    def is_pinhole(self) -> bool:
        return not any(self.distortion)

    @property
    def max_angle(self) -> float:
        return _perspective_limit(self.distortion)

    def project_jacobian(self, p_c: Float) -> Float:
        x, y, z = p_c[..., 0], p_c[..., 1], _nonzero(p_c[..., 2])
        J = np.zeros((*p_c.shape[:-1], 2, 3))
        J[..., 0, 0], J[..., 0, 2] = self.fx / z, -(self.fx * x) / z**2
        J[..., 1, 1], J[..., 1, 2] = self.fy / z, -(self.fy * y) / z**2
        if self.is_pinhole:
            return J
        aspect = self.fx / self.fy
        bend = distorted_jacobian(np.stack([x / z, y / z]), self.distortion)
        bend = np.moveaxis(bend, (0, 1), (-2, -1))
        return np.asarray(bend * np.array([[1, aspect], [1 / aspect, 1]]) @ J)

    def rays(self, uv: Float) -> Float:
        q = self.normalized(uv)
        ray = np.concatenate([q, np.ones((*q.shape[:-1], 1))], -1)
        return np.asarray(ray / np.linalg.norm(ray, axis=-1, keepdims=True))

    def normalized(self, uv: Float) -> Float:
        seen = np.stack([(uv[..., 0] - self.cx) / self.fx, (uv[..., 1] - self.cy) / self.fy], -1)
        if self.is_pinhole:
            return seen
        radius = np.linalg.norm(seen, axis=-1, keepdims=True)
        table, r = _table(self.distortion)
        q = seen * np.interp(radius, table, r) / np.maximum(radius, 1e-300)
        shown = radius[..., 0] < TABLE_REACH * table[-1]
        with np.errstate(all="ignore"):
            for _ in range(NEWTON_STEPS):
                (a, b), (_, c) = distorted_jacobian(np.moveaxis(q, -1, 0), self.distortion)
                e, f = np.moveaxis(self._distorted(q) - seen, -1, 0)
                step = np.stack([c * e - b * f, a * f - b * e], -1) / (a * c - b * b)[..., None]
                q = q - step
                if not (np.abs(step[shown]) > LAST_STEP).any():
                    break
            met = np.abs(self._distorted(q) - seen) < 1e-9 * (1 + radius)
            inside = np.linalg.norm(q, axis=-1) < np.tan(self.max_angle)
        return np.where((met.all(-1) & inside)[..., None], q, np.nan)

    def _plane(self, p_c: Float) -> Float:
        q = p_c[..., :2] / _nonzero(p_c[..., 2:])
        return np.asarray(q if self.is_pinhole else self._distorted(q))

    def _terms(self, p_c: Float) -> Float:
        q = p_c[..., :2] / _nonzero(p_c[..., 2:])
        J = term_jacobian(np.moveaxis(q, -1, 0), self.distortion)
        return np.asarray(np.moveaxis(J, (0, 1), (-1, -2)))

    def _distorted(self, q: Float) -> Float:
        """Apply the distortion to normalised coordinates (..., 2)."""
        there = distorted(np.moveaxis(q, -1, 0), self.distortion)
        return np.asarray(np.moveaxis(there, 0, -1))


def project_each(cameras: Sequence[Camera], view: Int, p_c: Float) -> Float:
    """Project points (M, 3), in the axes of views (M,), to pixels (M, 2) of these views."""
    uv = np.empty((len(p_c), 2))
    for camera, rows in _by_camera(cameras, view):
        uv[rows] = camera.project(p_c[rows])
    return uv


def back_project_each(cameras: Sequence[Camera], view: Int, uv: Float, depth: Float) -> Float:
    """Back-project pixels (M, 2) of views (M,) with z-depths (M,) to points in the views' axes."""
    p_c = np.empty((len(uv), 3))
    for camera, rows in _by_camera(cameras, view):
        p_c[rows] = camera.back_project(uv[rows], depth[rows])
    return p_c


def _by_camera(cameras: Sequence[Camera], view: Int) -> Iterator[tuple[Camera, NDArray[np.bool_]]]:
    """The cameras of views (M,), each once, and a mask (M,) of the rows that it has seen."""
    number = {camera: n for n, camera in enumerate(dict.fromkeys(cameras))}
    of_view = np.array([number[camera] for camera in cameras])[view]
    for camera, n in number.items():
        rows = of_view == n
        if rows.any():
            yield camera, rows


def _entries(K: Float) -> tuple[float, float, float, float]:
    """fx, fy, cx, cy of K (3, 3)."""
    return float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2])


def _padded(distortion: tuple[float, ...]) -> tuple[float, ...]:
    return distortion + (0.0,) * (8 - len(distortion))


def _nonzero(z: Float) -> Float:
    return np.where(z == 0, 1e-12, z)


@lru_cache
def _perspective_limit(distortion: tuple[float, ...]) -> float:
    """Smallest angle off the axis [rad] where the distorted radius has a maximum or a pole."""
    k1, k2, _, _, k3, k4, k5, k6 = _padded(distortion)
    radius, D = Polynomial([0, 1, 0, k1, 0, k2, 0, k3]), Polynomial([1, 0, k4, 0, k5, 0, k6])
    slope = radius.deriv() * D - radius * D.deriv()
    return float(np.arctan(min(first_root(slope, np.inf), first_root(D, np.inf))))


@lru_cache
def _table(distortion: tuple[float, ...]) -> tuple[Float, Float]:
    """Distorted radii, increasing, and those without distortion, below the limit."""
    r = np.tan(TABLE_RAD[_perspective_limit(distortion) > TABLE_RAD])
    return r * radial(r**2, distortion)[0], r


def first_root(polynomial: Polynomial, end: float) -> float:
    """Smallest real root between 0 and `end`, or `end`."""
    roots = polynomial.trim().roots()
    return float(min([*roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0)], end]))
