"""Which precision of a model runs on how many views, so that a recording can say it."""

from __future__ import annotations

from dataclasses import dataclass, replace

from calm_edge.backbones.base import BackboneError
from calm_edge.backbones.onnx import verdict
from calm_edge.backbones.onnx.manifest import Manifest, ManifestError, Precision
from calm_edge.backbones.onnx.model_folder import find_model, model_names, read_manifest, verify
from calm_edge.config import Config

# backbones whose argument is a model
WITH_MODEL = ("feedforward", "bundle")


def model_of(config: Config) -> str:
    """The model named by `backbone.name`: alone or behind a backbone; empty for none."""
    name, colon, argument = config.backbone.name.partition(":")
    if name in WITH_MODEL:
        return argument
    return name if not colon and name in model_names() else ""


def chosen(manifest: Manifest, asked: str, *, deterministic: bool = False) -> Precision:
    """asked: `backbone.precision`. Raises ManifestError where the model does not come in it.

    auto is what `model check` measured best on this machine, what the manifest says where it never
    ran, and fp32 where the answer must not depend on the machine.
    """
    have = manifest.precisions()
    if asked != "auto":
        for precision in have:
            if precision == asked:
                return precision
        raise ManifestError(f"{manifest.name}: has no {asked} graphs; it has {', '.join(have)}")
    if deterministic:
        return have[0]
    measured = verdict.load(manifest)
    if measured is not None and measured.precision in have:
        return measured.precision
    return manifest.unmeasured or have[0]


@dataclass(frozen=True, slots=True)
class Opened:
    """The model that a config asks for, fit to run. notices: lines for every prediction."""

    manifest: Manifest
    precision: Precision
    notices: tuple[str, ...]


def opened(config: Config) -> Opened:
    """Refuses a folder that is damaged, or that `model check` refused here: BackboneError."""
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
            f"{manifest.name} runs in {precision}, never checked on this machine: "
            f"calm-edge model check {name}",
        )
    return Opened(manifest, precision, notices)


def most_views(manifest: Manifest, precision: Precision, asked: int) -> int:
    """Views a run: as asked, else what `model check` measured, never above the manifest's.

    asked: `backbone.max_views`. Raises ManifestError.
    """
    if asked < 0 or asked == 1:
        raise ManifestError(f"backbone.max_views = {asked}: must be 0 or at least 2")
    measured = verdict.load(manifest)
    most = manifest.frames.max
    if asked:
        return min(asked, most)
    return min(most, measured.max_views.get(precision, most)) if measured else most


def pinned(config: Config, *, deterministic: bool) -> Config:
    """The config with `backbone.precision` and `max_views` as they will run, so that a recording
    says it and `map` does the same; raises ManifestError."""
    name = model_of(config)
    if not name:
        return config
    backbone = config.backbone
    manifest = read_manifest(find_model(name))
    precision = chosen(manifest, backbone.precision, deterministic=deterministic)
    views = most_views(manifest, precision, backbone.max_views)
    return replace(config, backbone=replace(backbone, precision=precision, max_views=views))
