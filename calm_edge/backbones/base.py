"""What every visual geometry model looks like to the rest of calm-edge (paper III)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from calm_edge.config import Config
from calm_edge.types import CalmEdgeError, Hints, Prediction


class BackboneError(CalmEdgeError):
    """The model cannot be loaded, or a batch cannot be reconstructed."""


class Backbone(Protocol):
    """N images -> intrinsics, poses, depth, confidence. Stateless: same input, same output."""

    name: str

    def infer(self, images: Sequence[NDArray[np.uint8]], hints: Hints) -> Prediction:
        """(H, W, 3) uint8 BGR images in batch order -> Prediction; raises BackboneError.

        Depth may be left out (None) by models that solve poses first.
        """
        ...

    def densify(
        self, images: Sequence[NDArray[np.uint8]], hints: Hints, prediction: Prediction
    ) -> Prediction:
        """The same prediction with depth and confidence; returned as is when it has them."""
        ...


def _bundle(config: Config) -> Backbone:
    from calm_edge.backbones.bundle.backbone import BundleBackbone

    return BundleBackbone(config.backbone)


def _scripted(config: Config) -> Backbone:
    from calm_edge.backbones.scripted import ScriptedBackbone

    return ScriptedBackbone.from_config(config)


BACKBONES: dict[str, Callable[[Config], Backbone]] = {"bundle": _bundle, "scripted": _scripted}


def open_backbone(config: Config) -> Backbone:
    """The backbone `backbone.name` asks for (`name` or `name:argument`); raises BackboneError."""
    name = config.backbone.name.partition(":")[0]
    if name not in BACKBONES:
        raise BackboneError(f"backbone.name = {name!r}: unknown; known: {', '.join(BACKBONES)}")
    return BACKBONES[name](config)
