"""Registry of backbones by name; opens the one that the configuration names.

Backbones are imported on demand: `bundle` runs without ONNX Runtime installed, and the scripted
backbone, which is not shipped, runs from a checkout.
"""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module

from calm_edge.backbones.base import Backbone, BackboneError, ResolvingBackbone
from calm_edge.backbones.undistorted import UndistortedPictures
from calm_edge.config import Config

# name -> "module:class"; the class is created by its from_config(Config)
BACKBONES = {
    "bundle": "calm_edge.backbones.bundle.backbone:BundleBackbone",
    "feedforward": "calm_edge.backbones.feedforward.backbone:FeedforwardBackbone",
    "scripted": "bench.scripted.backbone:ScriptedBackbone",
}


def open_backbone(config: Config) -> Backbone:
    """Create the backbone of `backbone.name`: `NAME`, `NAME:ARGUMENT`, or the name of a model.

    One that does not estimate the kit gets undistorted pictures. Raises BackboneError.
    """
    asked = config.backbone.name
    name = asked.partition(":")[0]
    if name not in BACKBONES:
        name = _kind_of_model(asked)
        config = replace(config, backbone=replace(config.backbone, name=f"{name}:{asked}"))
    module, _, class_name = BACKBONES[name].partition(":")
    try:
        backbone_class = getattr(import_module(module), class_name)
    except ModuleNotFoundError as error:
        raise BackboneError(
            f"backbone.name = {asked!r}: needs {error.name}, which is not installed here"
        ) from None
    backbone: Backbone = backbone_class.from_config(config)
    return backbone if isinstance(backbone, ResolvingBackbone) else UndistortedPictures(backbone)


def _kind_of_model(name: str) -> str:
    """Name of the backbone that runs a model. Raises BackboneError for an unknown name."""
    from calm_edge.backbones.onnx.model_folder import find_model, model_names, read_manifest

    if name not in model_names():
        known = ", ".join([*BACKBONES, *model_names()])
        raise BackboneError(f"backbone.name = {name!r}: unknown; known: {known}")
    return read_manifest(find_model(name)).kind
