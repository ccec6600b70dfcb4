"""Results of `model check` for this machine, cached on disk."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import platform
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

from calm_edge import typed
from calm_edge.backbones.onnx.manifest import Manifest, ManifestError, Precision
from device.atomic_file import replace_text

_RUNTIMES = ("onnxruntime", "onnxruntime-gpu")


@dataclass(frozen=True, slots=True)
class Verdict:
    """Result of `model check`. refusal: reason not to run the model, empty if it passed.

    precision: the chosen one. max_views: maximum number of views per run, by precision. why: one
    line that gives the reason for the choice of precision.
    """

    refusal: str
    precision: Precision
    max_views: dict[str, int]
    why: str


def cache_folder() -> Path:
    """`$XDG_CACHE_HOME/calm-edge/models`, by default under `~/.cache`."""
    base = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(base) if base else Path.home() / ".cache") / "calm-edge" / "models"


def machine() -> str:
    """Processor, number of cores and version of ONNX Runtime, for which a cached result holds."""
    model = platform.processor()
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        model = next((x for x in lines if x.startswith(("model name", "Model"))), model)
    except OSError:
        pass
    cores = len(os.sched_getaffinity(0))
    return f"{platform.machine()} {model.partition(':')[2].strip()} x{cores}, {_runtime()}"


def _runtime() -> str:
    for name in _RUNTIMES:
        try:
            return f"{name} {metadata.version(name)}"
        except metadata.PackageNotFoundError:
            continue
    return "no onnxruntime"


def _path(manifest: Manifest) -> Path:
    here = hashlib.sha256(machine().encode()).hexdigest()
    return cache_folder() / f"{manifest.digest[:32]}-{here[:12]}.json"


def load(manifest: Manifest) -> Verdict | None:
    """Read the cached result; None if there is none for this manifest and machine."""
    try:
        table = json.loads(_path(manifest).read_text())
        verdict: Verdict = typed.record("", Verdict, table, ManifestError)
    except (OSError, ValueError, ManifestError):
        return None
    return verdict


def save(manifest: Manifest, verdict: Verdict) -> Path:
    """Write the verdict to the cache; returns the file. Raises ManifestError."""
    path = _path(manifest)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        replace_text(path, json.dumps(dataclasses.asdict(verdict), indent=1) + "\n")
    except OSError as error:
        raise ManifestError(
            f"{path}: cannot be written ({error.strerror}); set XDG_CACHE_HOME to another folder"
        ) from None
    return path
