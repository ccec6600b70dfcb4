"""Write a model folder's manifest from its template, and the hashes of its files."""

from __future__ import annotations

import hashlib
from pathlib import Path

import onnx

MANIFEST = "manifest.toml"
_GRAPHS = "[graphs.model]"


def filled(
    template: str, size: tuple[int, int], max_views: int, license_name: str, scene: bool
) -> str:
    """The manifest without hashes. size: (width, height) px of the input."""
    return template.format(
        width=size[0],
        height=size[1],
        max_views=max_views,
        license=license_name,
        scene="true" if scene else "false",
    )


def set_variant(folder: Path, precision: str, graph: Path) -> None:
    """Enter a graph, its external weight files and their hashes as the given precision."""
    beside = ", ".join(f'"{name}" = "{sha256(folder / name)}"' for name in weight_files(graph))
    external = f", external = {{ {beside} }}" if beside else ""
    line = f'{precision} = {{ file = "{graph.name}", sha256 = "{sha256(graph)}"{external} }}'
    _replace(folder, _GRAPHS, f"{precision} = ", line)


def set_golden(folder: Path) -> None:
    """Enter the hash of golden.npz."""
    _replace(folder, "[golden]", "sha256 = ", f'sha256 = "{sha256(folder / "golden.npz")}"')


def weight_files(path: Path) -> list[str]:
    """Names of a graph's external weight files."""
    model = onnx.load(path, load_external_data=False)
    named = {
        entry.value
        for tensor in model.graph.initializer
        for entry in tensor.external_data
        if entry.key == "location"
    }
    return sorted(named)


def sha256(path: Path) -> str:
    """sha256 of a file in hexadecimal."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _replace(folder: Path, section: str, begins: str, line: str) -> None:
    """Put `line` into a section of the manifest, replacing the line that begins with `begins`."""
    path = folder / MANIFEST
    before, _, behind = path.read_text().partition(section + "\n")
    kept, _, others = behind.partition("\n[")
    lines = [each for each in kept.splitlines() if not each.startswith(begins)]
    rest = "\n[" + others if others else "\n"
    path.write_text(before + section + "\n" + "\n".join([line, *lines]) + rest)
