"""Decode a network's output tensors to intrinsics, poses, depth and confidence of the images."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calm_edge.backbones.base import BackboneError
from calm_edge.backbones.feedforward.decode import geometry
from calm_edge.backbones.feedforward.decode.intrinsics import intrinsics
from calm_edge.backbones.feedforward.decode.pose import poses
from calm_edge.backbones.onnx.manifest import Outputs
from calm_edge.backbones.onnx.picture_input import Fit
from calm_edge.geometry.camera import Camera
from calm_edge.types import Float, Float32, Prediction


@dataclass(frozen=True, slots=True)
class Decoded:
    """Decoded outputs of one run: N views, frame of the first view, unit of the network.

    cameras: N, of the images. T_s_c: (N, 4, 4) camera -> first view. depth: (N, h, w) z-depth
    on the grid of the network's input, 0 unknown. strength: (N, h, w) confidence in any unit,
    larger is better, -inf for none.
    """

    cameras: tuple[Camera, ...]
    T_s_c: Float
    depth: Float32
    strength: Float32


def decode(outputs: Outputs, raw: Mapping[str, NDArray[Any]], fits: Sequence[Fit]) -> Decoded:
    """Decode the output tensors `raw`, by name, of a run on images placed as in `fits`.

    Raises BackboneError for wrong shapes and for invalid poses, intrinsics or depth.
    """
    of_input = intrinsics(outputs, raw, fits)
    depth = geometry.z_depth(outputs.geometry, raw, of_input)
    if not depth.any():
        raise BackboneError("the network's depth is zero or not finite everywhere")
    return Decoded(
        cameras=tuple(fit.camera(c) for fit, c in zip(fits, of_input, strict=True)),
        T_s_c=poses(outputs.pose, raw[outputs.pose.name], len(fits)),
        depth=depth,
        strength=geometry.strength(outputs.confidence, raw, depth.shape),
    )


def prediction(decoded: Decoded, fits: Sequence[Fit], notices: tuple[str, ...] = ()) -> Prediction:
    """Convert to a Prediction (paper III): maps resampled to the images, confidence to ranks."""
    depth = geometry.on_picture_grid(decoded.depth, fits, 0.0)
    strength = geometry.on_picture_grid(decoded.strength, fits, -np.inf)
    return Prediction(
        cameras=decoded.cameras,
        T_s_c=decoded.T_s_c,
        depth=depth,
        confidence=geometry.percentiles(strength, depth),
        notices=notices,
    )
