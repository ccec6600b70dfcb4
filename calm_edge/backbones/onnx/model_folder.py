"""Find model folders by name, read and check their manifests, verify file hashes."""

from __future__ import annotations

import dataclasses
import hashlib
import math
import os
import tomllib
from collections.abc import Iterable, Iterator
from pathlib import Path, PurePosixPath

from calm_edge import typed
from calm_edge.backbones.onnx.manifest import (
    FORMAT,
    PRECISIONS,
    ROLES,
    InputSpec,
    Manifest,
    ManifestError,
    Outputs,
    Precision,
)

MANIFEST = "manifest.toml"
LICENSE = "LICENSE"
SHIPPED = Path(__file__).resolve().parents[2] / "models"
# in a source checkout: the output of the `export.py` scripts
EXPORTED = SHIPPED.parents[1] / "models"
_CHANNELS = {"rgb": 3, "bgr": 3, "gray": 1}


def search_path() -> list[Path]:
    """Folders with models in search order: shipped, exported, of the user, of the system.

    The last two: `calm-edge/models` in the data folders of the XDG Base Directory Specification.
    """
    exported = [EXPORTED] if (EXPORTED.parent / "pyproject.toml").is_file() else []
    user = os.environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share"
    machine = os.environ.get("XDG_DATA_DIRS") or "/usr/local/share:/usr/share"
    data = (Path(folder) / "calm-edge" / "models" for folder in (user, *machine.split(":")))
    return [SHIPPED, *exported, *data]


def model_names() -> list[str]:
    """List the names under which `find_model` finds a model."""
    found = (path for folder in search_path() for path in folder.glob(f"*/{MANIFEST}"))
    return sorted({path.parent.name for path in found})


def find_model(name: str) -> Path:
    """Return the folder of a model, by its name or by the folder's path; raises ManifestError."""
    folders = search_path()
    for folder in [*(folder / name for folder in folders), Path(name)]:
        if name and (folder / MANIFEST).is_file():
            return folder
    for folder in folders:
        if name and (folder / name / "export.py").is_file():
            raise ManifestError(
                f"model {name!r}: not exported yet; calm-edge does not ship its weights: see "
                f"{folder / name / 'README.md'}"
            )
    known = ", ".join(model_names())
    raise ManifestError(
        f"model {name!r}: neither a known name ({known}) nor a folder with {MANIFEST}"
    )


def read_manifest(folder: Path) -> Manifest:
    """Read and check `manifest.toml` of a model folder, without its other files.

    Raises ManifestError.
    """
    path = folder / MANIFEST
    try:
        content = path.read_bytes()
        table = tomllib.loads(content.decode())
    except OSError as error:
        raise ManifestError(f"{path}: cannot be read ({error.strerror})") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ManifestError(f"{path}: not valid TOML: {error}") from None
    for key in ("folder", "digest"):
        if key in table:
            raise ManifestError(f"{path}: {key}: no such key")
    try:
        manifest: Manifest = typed.record("", Manifest, table, ManifestError)
    except ManifestError as error:
        raise ManifestError(f"{path}: {error}") from None
    for mistake in _mistakes(manifest):
        raise ManifestError(f"{path}: {mistake}")
    digest = hashlib.sha256(content).hexdigest()
    return dataclasses.replace(manifest, folder=folder, digest=digest)


def verify(manifest: Manifest, precisions: Iterable[Precision] = PRECISIONS) -> int:
    """Compare files with their sha256; returns the number of files. Raises ManifestError.

    precisions: of the graphs to verify. The golden values and the presence of a LICENSE are always
    verified.
    """
    if not (manifest.folder / LICENSE).is_file():
        raise ManifestError(f"{manifest.folder / LICENSE}: missing; add the model's licence")
    expected = {manifest.golden.file: manifest.golden.sha256}
    for graph in manifest.graphs.values():
        for precision, variant in graph.variants().items():
            if precision in precisions:
                expected |= variant.files()
    for file, sha256 in expected.items():
        path = manifest.folder / file
        try:
            with path.open("rb") as stream:
                found = hashlib.file_digest(stream, "sha256").hexdigest()
        except OSError as error:
            raise ManifestError(f"{path}: cannot be read ({error.strerror})") from None
        if found != sha256.lower():
            raise ManifestError(
                f"{path}: sha256 is {found[:12]}..., the manifest has {sha256[:12]}...; "
                "fetch or export the file again"
            )
    return len(expected)


def _mistakes(m: Manifest) -> Iterator[str]:
    """Find contradictions between the values of a manifest, one line of text each."""
    if m.format != FORMAT:
        yield f"format = {m.format}: this calm-edge reads {FORMAT}; export the model again"
    yield from _graph_mistakes(m)
    yield from _input_mistakes(m.input)
    frames = m.frames
    if not 1 <= frames.min <= frames.max:
        yield f"frames: expected 1 <= min <= max, got {frames.min} and {frames.max}"
    if not frames.dynamic and frames.min != frames.max:
        yield "frames: dynamic is false, so min and max must be equal"
    if not all(t > 0 and math.isfinite(t) for t in map(m.golden.tolerance, PRECISIONS)):
        yield "golden: a tolerance must be above 0"
    if m.kind == "feedforward":
        if m.output is None:
            yield "output: missing; kind feedforward needs it"
        else:
            yield from _output_mistakes(m.output)
    elif m.output is not None:
        yield "output: only allowed for kind feedforward"


def _graph_mistakes(m: Manifest) -> Iterator[str]:
    if not m.graphs:
        yield f"graphs: none; kind {m.kind} has {', '.join(ROLES[m.kind])}"
    files = {m.golden.file: m.golden.sha256}
    for role, graph in m.graphs.items():
        if role not in ROLES[m.kind]:
            yield f"graphs.{role}: no such role; kind {m.kind} has {', '.join(ROLES[m.kind])}"
        if not graph.variants():
            yield f"graphs.{role}: names no file; expected one of {', '.join(PRECISIONS)}"
        for variant in graph.variants().values():
            files |= variant.files()
    if m.graphs and not m.precisions():
        yield "graphs: there is no precision that all of them have"
    elif m.unmeasured and m.unmeasured not in m.precisions():
        yield f"unmeasured = {m.unmeasured}: not all graphs have it"
    for file, sha256 in files.items():
        path = PurePosixPath(file)
        if not path.name or path.is_absolute() or ".." in path.parts:
            yield f"{file!r}: must be a file inside the model's folder"
        if len(sha256) != 64 or not set(sha256.lower()) <= set("0123456789abcdef"):
            yield f"{file}: sha256 = {sha256!r}: expected 64 hexadecimal digits"


def _input_mistakes(spec: InputSpec) -> Iterator[str]:
    channels = _CHANNELS[spec.channels]
    for key, values in (("mean", spec.mean), ("std", spec.std)):
        if len(values) not in (1, channels):
            yield f"input.{key}: expected 1 or {channels} numbers, got {len(values)}"
    if not all(s > 0 for s in spec.std):
        yield "input.std: must be above 0"
    if (spec.resize == "keep") != (spec.size_px == 0):
        yield "input.size_px: needed for resize width and longest, not allowed for keep"
    if spec.size_px < 0 or spec.height_px < 0 or spec.multiple < 1:
        yield "input: size_px and height_px must not be negative, multiple at least 1"
    for key, size in (("size_px", spec.size_px), ("height_px", spec.height_px)):
        if size % max(spec.multiple, 1):
            yield f"input.{key} = {size}: not a multiple of {spec.multiple}"


def _output_mistakes(output: Outputs) -> Iterator[str]:
    intrinsics, geometry = output.intrinsics, output.geometry
    if intrinsics.encoding == "pixels" and not intrinsics.name:
        yield "output.intrinsics.name: missing; encoding pixels needs it"
    in_pose = output.pose.encoding == "t_quatxyzw_fovhw"
    if intrinsics.encoding == "fov" and bool(intrinsics.name) == in_pose:
        yield (
            "output.intrinsics.name: needed for fov, and not allowed if the pose is "
            "t_quatxyzw_fovhw"
        )
    if intrinsics.encoding == "solved":
        if intrinsics.name:
            yield "output.intrinsics.name: not allowed for solved"
        if geometry.encoding == "z_depth" or (
            geometry.encoding == "ray_depth" and not geometry.rays
        ):
            yield "output.intrinsics: solved needs a point_map, or ray_depth with rays"
    if geometry.rays and geometry.encoding != "ray_depth":
        yield "output.geometry.rays: only allowed for ray_depth"
