"""Which precision of a model's graphs runs, so that a recording can say it."""

from __future__ import annotations

from dataclasses import replace

from calm_edge.backbones import verdict
from calm_edge.backbones.base import BACKBONES
from calm_edge.backbones.manifest import Manifest, ManifestError, Precision
from calm_edge.backbones.model_folder import find_model, model_names, read_manifest
from calm_edge.config import Config

# backbones whose argument is a model
WITH_MODEL = ("feedforward", "bundle")


def model_of(config: Config) -> str:
    """The model that `backbone.name` asks for, empty where it asks for none."""
    name, _, argument = config.backbone.name.partition(":")
    if name in WITH_MODEL:
        return argument
    known = name not in BACKBONES and config.backbone.name in model_names()
    return config.backbone.name if known else ""


def chosen(manifest: Manifest, asked: str, *, deterministic: bool = False) -> Precision:
    """asked: `backbone.precision`. Raises ManifestError where the model does not come in it.

    auto is what `model check` measured best on this machine; fp32 where it never ran, and where
    the answer must not depend on the machine.
    """
    have = manifest.precisions()
    if asked != "auto":
        for precision in have:
            if precision == asked:
                return precision
        raise ManifestError(f"{manifest.name}: has no {asked} graphs; it has {', '.join(have)}")
    measured = None if deterministic else verdict.load(manifest)
    if measured is not None and measured.precision in have:
        return measured.precision
    return have[0]


def pinned(config: Config, *, deterministic: bool) -> Config:
    """The config with `backbone.precision` as it will run; raises ManifestError."""
    name = model_of(config)
    if not name:
        return config
    manifest = read_manifest(find_model(name))
    precision = chosen(manifest, config.backbone.precision, deterministic=deterministic)
    return replace(config, backbone=replace(config.backbone, precision=precision))
