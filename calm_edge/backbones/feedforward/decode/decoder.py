"""What a network said of its input -> what is true of the pictures: the one way in of decoding."""

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
from calm_edge.types import Float, Float32, Prediction


@dataclass(frozen=True, slots=True)
class Decoded:
    """One run: N views in the frame of the first, in the network's unit.

    K: (N, 3, 3) px of the pictures. T_s_c: (N, 4, 4) camera->first view. depth: (N, h, w) z-depth
    on the grid of the network's input, 0 unknown. strength: (N, h, w) of any unit, larger is more
    confident, -inf none.
    """

    K: Float
    T_s_c: Float
    depth: Float32
    strength: Float32


def decode(outputs: Outputs, raw: Mapping[str, NDArray[Any]], fits: Sequence[Fit]) -> Decoded:
    """Output tensors by name of one run over pictures that lay in the input as `fits` say.

    Raises BackboneError for wrong shapes, and for poses, intrinsics or depth that are none.
    """
    K_input = intrinsics(outputs, raw, fits)
    depth = geometry.z_depth(outputs.geometry, raw, K_input, fits)
    if not depth.any():
        raise BackboneError("the network gave no depth above zero")
    return Decoded(
        K=np.stack([fit.intrinsics(K) for fit, K in zip(fits, K_input, strict=True)]),
        T_s_c=poses(outputs.pose, raw[outputs.pose.name], len(fits)),
        depth=depth,
        strength=geometry.strength(outputs.confidence, raw, depth.shape),
    )


def prediction(decoded: Decoded, fits: Sequence[Fit], notices: tuple[str, ...] = ()) -> Prediction:
    """The same as everything behind a backbone reads it (paper III): maps cover the pictures."""
    depth = geometry.on_picture_grid(decoded.depth, fits, 0.0)
    strength = geometry.on_picture_grid(decoded.strength, fits, -np.inf)
    return Prediction(
        K=decoded.K,
        T_s_c=decoded.T_s_c,
        depth=depth,
        confidence=geometry.percentiles(strength, depth),
        notices=notices,
    )
