"""Decode depth and confidence to z-depth and strength maps, and resample these to the images."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from calm_edge.backbones.feedforward.decode.arrays import of_views
from calm_edge.backbones.onnx.manifest import ConfidenceOutput, GeometryOutput
from calm_edge.backbones.onnx.picture_input import Fit
from calm_edge.geometry.camera import Camera
from calm_edge.types import Float, Float32

# lower bound of exp(x) for expp1 before taking the logarithm
_WEAKEST = 1e-30


def z_depth(
    spec: GeometryOutput, raw: Mapping[str, NDArray[Any]], cameras: Sequence[Camera]
) -> Float32:
    """Decode z-depth (N, h, w) on the grid of the output, unit of the network, 0 unknown.

    cameras: N, of the input. Raises BackboneError for a wrong shape.
    """
    n = len(cameras)
    if spec.encoding == "point_map":
        z = of_views(spec.name, raw[spec.name], n, (None, None, 3))[..., 2]
    else:
        z = of_views(spec.name, raw[spec.name], n, (None, None))
    if spec.encoding == "ray_depth":
        if spec.rays:
            rays = of_views(spec.rays, raw[spec.rays], n, (*z.shape[1:], 3))
        else:
            rays = _rays(cameras, z.shape[1:])
        with np.errstate(all="ignore"):
            z = z * rays[..., 2] / np.linalg.norm(rays, axis=-1)
    return np.where(np.isfinite(z) & (z > 0), z, 0).astype(np.float32)


def _rays(cameras: Sequence[Camera], shape: tuple[int, ...]) -> Float:
    """Rays (N, h, w, 3), z = 1, through the pixels of a map of `shape` over the input."""
    (h, w), width, height = shape, cameras[0].width, cameras[0].height
    u = (np.arange(w) + 0.5) * (width / w) - 0.5
    v = (np.arange(h) + 0.5) * (height / h) - 0.5
    uv = np.stack(np.meshgrid(u, v), -1)
    return np.stack([camera.back_project(uv, np.ones((h, w))) for camera in cameras])


def strength(
    spec: ConfidenceOutput | None, raw: Mapping[str, NDArray[Any]], shape: tuple[int, ...]
) -> Float32:
    """Decode confidence to a strength (N, h, w): any unit, larger is better, -inf for none.

    Constant if the model has no confidence. shape: of the depth maps. expp1 = 1 + exp(x) is
    converted to x, so that small values remain distinct. Raises BackboneError for a wrong shape.
    """
    if spec is None:
        return np.zeros(shape, np.float32)
    n, h, w = shape
    values = of_views(spec.name, raw[spec.name], n, (None, None))
    if spec.encoding == "expp1":
        with np.errstate(invalid="ignore"):
            values = np.where(values > 1, np.log(np.maximum(values - 1, _WEAKEST)), -np.inf)
    values = np.where(np.isnan(values), -np.inf, values).astype(np.float32)
    if values.shape[1:] != (h, w):
        near = [cv2.resize(v, (w, h), interpolation=cv2.INTER_NEAREST_EXACT) for v in values]
        values = np.stack(near)
    return np.asarray(values, np.float32)


def on_picture_grid(maps: Float32, fits: Sequence[Fit], unknown: float) -> Float32:
    """Resample maps (N, h, w) of the input to the area of each image, (N, h', w').

    Nearest neighbour; pixels of the image outside the input get `unknown`. h', w': the rows and
    columns of a map that the image covers, the most of all images; h, w if all images fill the
    input.
    """
    h, w = maps.shape[1:]
    if all(fit.is_whole for fit in fits):
        return maps
    rows = max(max(1, round(fit.resized[1] * h / fit.input[1])) for fit in fits)
    columns = max(max(1, round(fit.resized[0] * w / fit.input[0])) for fit in fits)
    out = np.full((len(fits), rows, columns), unknown, np.float32)
    for view, fit in enumerate(fits):
        row = np.floor(fit.positions(1, rows, h) + 0.5).astype(np.int64)
        column = np.floor(fit.positions(0, columns, w) + 0.5).astype(np.int64)
        shown_r, shown_c = (row >= 0) & (row < h), (column >= 0) & (column < w)
        part = maps[view][np.ix_(row[shown_r], column[shown_c])]
        out[view][np.ix_(shown_r, shown_c)] = part
    return out


def percentiles(strength: Float32, depth: Float32) -> Float32:
    """Confidence (N, h, w) in [0, 1] as rank: share of the window's pixels that are not stronger.

    0 for pixels without depth or strength. Ranks make thresholds independent of the model's
    confidence unit and of quantisation.
    """
    known = (depth > 0) & (strength > -np.inf)
    values = strength[known]
    confidence = np.zeros(depth.shape, np.float32)
    if len(values):
        rank = np.searchsorted(np.sort(values), values, side="right")
        confidence[known] = rank / len(values)
    return confidence
