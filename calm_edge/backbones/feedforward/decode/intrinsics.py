"""Decode intrinsics to cameras of the network's input."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calm_edge.backbones.base import BackboneError
from calm_edge.backbones.feedforward.decode.arrays import of_views
from calm_edge.backbones.onnx.manifest import Outputs
from calm_edge.backbones.onnx.picture_input import Fit
from calm_edge.geometry.camera import Camera, Perspective
from calm_edge.types import Float

# Robust fit: minimum pixels, iterations of reweighting, and Huber's threshold in robust sigmas
# (1.345 has 95 % efficiency for Gaussian noise).
MIN_PIXELS = 16
ROUNDS = 4
HUBER = 1.345


def intrinsics(
    outputs: Outputs, raw: Mapping[str, NDArray[Any]], fits: Sequence[Fit]
) -> tuple[Camera, ...]:
    """Decode N cameras of the input; a skew is dropped. Raises BackboneError."""
    spec, n = outputs.intrinsics, len(fits)
    size = fits[0].input
    if spec.encoding == "pixels":
        K = of_views(spec.name, raw[spec.name], n, (3, 3))
        rows = K[:, [0, 1, 0, 1], [0, 1, 2, 2]]
        if spec.pixel_origin == "corner":
            rows[:, 2:] -= 0.5
    elif spec.encoding == "fov":
        name = spec.name or outputs.pose.name
        fov = of_views(name, raw[name], n, (2,) if spec.name else (9,))[:, -2:]
        rows = _of_fov(fov, size)
    else:
        name = outputs.geometry.rays or outputs.geometry.name
        rays = of_views(name, raw[name], n, (None, None, 3))
        free = spec.principal_point == "free"
        rows = np.stack([solved(r, fit, free) for r, fit in zip(rays, fits, strict=True)])
    if not (np.isfinite(rows).all() and (rows[:, :2] > 0).all()):
        raise BackboneError("the network's intrinsics are not finite or a focal is not positive")
    return tuple(Perspective(fx, fy, cx, cy, *size) for fx, fy, cx, cy in rows.tolist())


def _of_fov(fov: Float, size: tuple[int, int]) -> Float:
    """fx, fy, cx, cy (N, 4), px, from fields of view (N, 2), vertical and horizontal [rad].

    size: width, height px. The principal point is the image centre. Raises BackboneError.
    """
    if not (np.isfinite(fov).all() and (fov > 0).all() and (fov < np.pi).all()):
        raise BackboneError("the network's field of view is outside 0 to 180 degrees")
    width, height = size
    focal = np.array([height, width]) / 2 / np.tan(fov / 2)
    middle = np.tile([(width - 1) / 2, (height - 1) / 2], (len(fov), 1))
    return np.concatenate([focal[:, ::-1], middle], 1)


def solved(rays: Float, fit: Fit, free: bool) -> Float:
    """Fit fx, fy, cx, cy (4,), px of the input, to rays or points (h, w, 3), camera axes, robustly.

    Regresses the slopes x/z, which have noise, on the pixel coordinates, which have none; the
    reverse would bias the focal length low. free: fit the principal point; False: image centre.
    Padded pixels are ignored. Raises BackboneError with too few points.
    """
    h, w = rays.shape[:2]
    width, height = fit.input
    u = (np.arange(w) + 0.5) * (width / w) - 0.5
    v = (np.arange(h) + 0.5) * (height / h) - 0.5
    inside = _inside(v, fit, 1)[:, None] & _inside(u, fit, 0)
    with np.errstate(all="ignore"):
        x, y = rays[..., 0] / rays[..., 2], rays[..., 1] / rays[..., 2]
    good = inside & (rays[..., 2] > 0) & np.isfinite(x) & np.isfinite(y)
    if good.sum() < MIN_PIXELS:
        raise BackboneError("the network gives too few points to fit a focal length")
    U, V = np.broadcast_to(u, (h, w)), np.broadcast_to(v[:, None], (h, w))
    fx, cx = _line(U[good], x[good], (width - 1) / 2, free)
    fy, cy = _line(V[good], y[good], (height - 1) / 2, free)
    return np.array([fx, fy, cx, cy])


def _inside(positions: Float, fit: Fit, axis: int) -> NDArray[np.bool_]:
    start = fit.offset[axis]
    return (positions > start - 0.5) & (positions < start + fit.resized[axis] - 0.5)


def _line(pixel: Float, slope: Float, middle: float, free: bool) -> tuple[float, float]:
    """Fit slope = (pixel - centre) / focal by reweighted least squares: focal and centre, px.

    middle: centre if not free. Raises BackboneError.
    """
    weight = np.ones(len(pixel))
    a = b = 0.0
    for _ in range(ROUNDS):
        mean_p = float(weight @ pixel / weight.sum()) if free else middle
        mean_s = float(weight @ slope / weight.sum()) if free else 0.0
        d = pixel - mean_p
        spread = float(weight @ d**2)
        a = float(weight @ (d * (slope - mean_s))) / spread if spread > 0 else 0.0
        b = mean_s - a * mean_p
        residual = np.abs(slope - a * pixel - b)
        sigma = 1.4826 * float(np.median(residual))
        if sigma < 1e-12:
            break
        weight = np.minimum(1.0, HUBER * sigma / np.maximum(residual, 1e-300))
    if not a > 0:
        raise BackboneError("the network's points fit no positive focal length")
    return 1 / a, -b / a
