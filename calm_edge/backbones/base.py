"""What every visual geometry model looks like to the rest of calm-edge (paper III)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Protocol, runtime_checkable

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


@runtime_checkable
class ExpectsPictures(Protocol):
    """A backbone that may be able to begin on a picture before its window is whole."""

    @property
    def expects_pictures(self) -> bool:
        """Whether it is: else there is no use in telling it."""
        ...

    def expect(self, image: NDArray[np.uint8]) -> None:
        """(H, W, 3) uint8 BGR of a primary keyframe; the answer to its window stays the same."""
        ...


def _bundle(config: Config) -> Backbone:
    from calm_edge.backbones.bundle.backbone import BundleBackbone

    return BundleBackbone.from_config(config)


def _scripted(config: Config) -> Backbone:
    from calm_edge.backbones.scripted import ScriptedBackbone

    return ScriptedBackbone.from_config(config)


def _feedforward(config: Config) -> Backbone:
    from calm_edge.backbones.feedforward import FeedforwardBackbone

    return FeedforwardBackbone.from_config(config)


BACKBONES: dict[str, Callable[[Config], Backbone]] = {
    "bundle": _bundle,
    "feedforward": _feedforward,
    "scripted": _scripted,
}


def open_backbone(config: Config) -> Backbone:
    """The backbone `backbone.name` asks for: `name`, `name:argument`, or a folder of `models/`.

    Raises BackboneError.
    """
    asked = config.backbone.name
    name = asked.partition(":")[0]
    if name not in BACKBONES:
        name = _kind_of_model(asked)
        config = replace(config, backbone=replace(config.backbone, name=f"{name}:{asked}"))
    return BACKBONES[name](config)


def _kind_of_model(name: str) -> str:
    """The backbone that runs a folder of `models/`; raises BackboneError where there is none."""
    from calm_edge.backbones.model_folder import find_model, model_names, read_manifest

    if name not in model_names():
        known = ", ".join([*BACKBONES, *model_names()])
        raise BackboneError(f"backbone.name = {name!r}: unknown; known: {known}")
    return read_manifest(find_model(name)).kind
