"""Choose a model's precision and number of views per run, and open it.

`pinned` writes the choice to the configuration, so that a recording contains it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from calm_edge.backbones.base import BackboneError
from calm_edge.backbones.onnx import verdict
from calm_edge.backbones.onnx.manifest import Manifest, ManifestError, Precision
from calm_edge.backbones.onnx.model_folder import find_model, model_names, read_manifest, verify
from calm_edge.config import Config

# backbones that take a model as argument
WITH_MODEL = ("feedforward", "bundle")


def model_of(config: Config) -> str:
    """Name of the model in `backbone.name`, `MODEL` or `BACKBONE:MODEL`; empty for none."""
    name, colon, argument = config.backbone.name.partition(":")
    if name in WITH_MODEL:
        return argument
    return name if not colon and name in model_names() else ""


def chosen(manifest: Manifest, asked: str, *, deterministic: bool = False) -> Precision:
    """Precision to run. asked: `backbone.precision`.

    `auto` is the fastest measured by `model check` on this machine, else the manifest's
    `unmeasured`; with `deterministic`, where results must not depend on the machine, the first
    one of the model (fp32 if it has that). Raises ManifestError if the model has no such precision.
    """
    have = manifest.precisions()
    if asked != "auto":
        for precision in have:
            if precision == asked:
                return precision
        raise ManifestError(
            f"backbone.precision = {asked}: {manifest.name} has no {asked} graphs; "
            f"it has {', '.join(have)}"
        )
    if deterministic:
        return have[0]
    measured = verdict.load(manifest)
    if measured is not None and measured.precision in have:
        return measured.precision
    return manifest.unmeasured or have[0]


@dataclass(frozen=True, slots=True)
class Opened:
    """A verified model and the precision to run. notices: lines to show with each prediction."""

    manifest: Manifest
    precision: Precision
    notices: tuple[str, ...]


def opened(config: Config) -> Opened:
    """Open and verify the model of a configuration.

    Raises BackboneError if the folder is damaged or `model check` has refused it on this machine.
    """
    name = model_of(config)
    manifest = read_manifest(find_model(name))
    precision = chosen(manifest, config.backbone.precision)
    found = verdict.load(manifest)
    if found is not None and found.refusal:
        raise BackboneError(f"{manifest.name}: refused by model check: {found.refusal}")
    verify(manifest, [precision])
    notices: tuple[str, ...] = ()
    if found is None and not manifest.unmeasured:
        notices = (
            f"{manifest.name} runs in {precision}, not checked on this machine; run "
            f"calm-edge model check {name}",
        )
    return Opened(manifest, precision, notices)


def most_views(manifest: Manifest, precision: Precision, asked: int) -> int:
    """Maximum number of views per run, at most the manifest's.

    asked: `backbone.max_views`; 0: as measured by `model check`. Raises ManifestError.
    """
    if asked < 0 or asked == 1:
        raise ManifestError(f"backbone.max_views = {asked}: must be 0 or at least 2")
    measured = verdict.load(manifest)
    most = manifest.frames.max
    if asked:
        return min(asked, most)
    return min(most, measured.max_views.get(precision, most)) if measured else most


def pinned(config: Config, *, deterministic: bool) -> Config:
    """The config with `auto` resolved in `backbone.precision` and `backbone.max_views`.

    Recorded, so that `map` runs the model as `record` did. Raises ManifestError.
    """
    name = model_of(config)
    if not name:
        return config
    backbone = config.backbone
    manifest = read_manifest(find_model(name))
    precision = chosen(manifest, backbone.precision, deterministic=deterministic)
    views = most_views(manifest, precision, backbone.max_views)
    return replace(config, backbone=replace(backbone, precision=precision, max_views=views))
