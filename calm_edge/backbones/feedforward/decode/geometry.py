"""Depth and confidence of any encoding -> z-depth and strength, on the grid of the pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from calm_edge.backbones.feedforward.decode.arrays import of_views
from calm_edge.backbones.onnx.manifest import ConfidenceOutput, GeometryOutput
from calm_edge.backbones.onnx.picture_input import Fit
from calm_edge.geometry import pinhole
from calm_edge.types import Float, Float32

# below this share expp1 counts as none: exp(x) of the weakest x that float32 tells from zero
_WEAKEST = 1e-30


def z_depth(
    spec: GeometryOutput, raw: Mapping[str, NDArray[Any]], K: Float, fits: Sequence[Fit]
) -> Float32:
    """(N, h, w) z-depth on the grid of the output, unit of the network, 0 unknown.

    K: (N, 3, 3) px of the input. Raises BackboneError for a wrong shape.
    """
    n = len(fits)
    if spec.encoding == "point_map":
        z = of_views(spec.name, raw[spec.name], n, (None, None, 3))[..., 2]
    else:
        z = of_views(spec.name, raw[spec.name], n, (None, None))
    if spec.encoding == "ray_depth":
        if spec.rays:
            rays = of_views(spec.rays, raw[spec.rays], n, (*z.shape[1:], 3))
        else:
            rays = _rays(K, z.shape[1:], fits[0].input)
        with np.errstate(all="ignore"):
            z = z * rays[..., 2] / np.linalg.norm(rays, axis=-1)
    return np.where(np.isfinite(z) & (z > 0), z, 0).astype(np.float32)


def _rays(K: Float, shape: tuple[int, ...], size: tuple[int, int]) -> Float:
    """(N, h, w, 3) rays with z = 1 through the pixels of a map of the input, `size` px."""
    (h, w), (width, height) = shape, size
    u = (np.arange(w) + 0.5) * (width / w) - 0.5
    v = (np.arange(h) + 0.5) * (height / h) - 0.5
    uv = np.stack(np.meshgrid(u, v), -1)
    return np.stack([pinhole.back_project(k, uv, np.ones((h, w))) for k in K])


def strength(
    spec: ConfidenceOutput | None, raw: Mapping[str, NDArray[Any]], shape: tuple[int, ...]
) -> Float32:
    """(N, h, w) of any unit, larger is better, -inf none; alike where the model has none.

    shape: of the depth. expp1 is brought to the logarithm of its exponential part, so that no
    order is lost to the 1. Raises BackboneError for a wrong shape.
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
    """Maps (N, h, w) of the input, cut to what each picture covers: (N, h', w').

    A pixel takes the nearest value; what the input did not show is `unknown`. The grid is as fine
    as the map is over the largest picture.
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
    """Confidence (N, h, w) in [0, 1]: the share of the pixels with depth that are believed no more.

    0 without depth or strength. So quantisation, which shifts every score, shifts no threshold.
    """
    known = (depth > 0) & (strength > -np.inf)
    values = strength[known]
    confidence = np.zeros(depth.shape, np.float32)
    if len(values):
        rank = np.searchsorted(np.sort(values), values, side="right")
        confidence[known] = rank / len(values)
    return confidence
