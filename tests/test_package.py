"""The wheel holds the product with its network and nothing else; every dependency is pinned."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from email.message import Message
from email.parser import HeaderParser
from itertools import chain
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import calm_edge

ROOT = Path(__file__).resolve().parents[1]
CALM_GEO = {
    f"calm_edge/models/calm-geo/{name}"
    for name in ("LICENSE", "encoder.int8.onnx", "encoder.onnx", "golden.npz", "manifest.toml")
} | {"calm_edge/models/calm-geo/refine.onnx"}
VIEWER = {
    f"calm_edge/{folder}/{path.name}"
    for folder in ("report/viewer", "live/page", "live/shared", "commands/setup_files")
    for path in (ROOT / "calm_edge" / folder).iterdir()
    if path.suffix in (".css", ".html", ".js")
}


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> zipfile.ZipFile:
    """Built from a copy of the checkout: a build leaves its traces in the tree it is of."""
    folder = tmp_path_factory.mktemp("package")
    others = shutil.ignore_patterns(".*", "build", "demo", "__pycache__", "*.egg-info")
    shutil.copytree(ROOT, folder / "tree", ignore=others)
    command = [sys.executable, "-m", "pip", "wheel", "-q", "--no-index", "--no-deps"]
    command += ["--no-build-isolation", "-w", str(folder), str(folder / "tree")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    (path,) = folder.glob("*.whl")
    assert path.name == f"calm_edge-{calm_edge.__version__}-py3-none-any.whl"
    return zipfile.ZipFile(path)


def metadata(wheel: zipfile.ZipFile) -> Message:
    (name,) = (name for name in wheel.namelist() if name.endswith(".dist-info/METADATA"))
    return HeaderParser().parsestr(wheel.read(name).decode())


def pins() -> dict[str, str]:
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pairs = [line.split("==") for line in lines if line and not line.startswith("#")]
    return {canonicalize_name(name): version for name, version in pairs}


def test_the_wheel_holds_both_packages_the_network_and_the_viewer_alone(
    wheel: zipfile.ZipFile,
) -> None:
    modules = {
        str(path.relative_to(ROOT))
        for package in ("calm_edge", "device")
        for path in (ROOT / package).rglob("*.py")
    }
    held = {name for name in wheel.namelist() if ".dist-info/" not in name}
    assert held == modules | CALM_GEO | VIEWER
    for name in CALM_GEO | VIEWER:
        assert wheel.read(name) == (ROOT / name).read_bytes()


def test_no_shipped_file_names_a_path_outside_the_package(wheel: zipfile.ZipFile) -> None:
    # drives of the measurements, and stack traces that torch's exporter leaves in graphs
    outside = re.compile(rb'\bshared/(data|tools|models)|File "/')
    assert [name for name in wheel.namelist() if outside.search(wheel.read(name))] == []


def test_the_command_and_the_extras_are_declared(wheel: zipfile.ZipFile) -> None:
    assert metadata(wheel)["Version"] == calm_edge.__version__
    assert {"oak", "systemd"} < set(metadata(wheel).get_all("Provides-Extra", []))
    (name,) = (name for name in wheel.namelist() if name.endswith("entry_points.txt"))
    assert "calm-edge = calm_edge.cli:main" in wheel.read(name).decode()


def test_every_declared_dependency_is_pinned_within_its_bounds() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    declared = [Requirement(t) for t in (*project["dependencies"], *chain(*extras.values()))]
    pinned = pins()
    for requirement in declared:
        version = pinned[canonicalize_name(requirement.name)]
        assert version in requirement.specifier, f"{requirement}: {version} is pinned"
    shipped = [Requirement(t) for key in extras if key != "dev" for t in extras[key]]
    for requirement in [*map(Requirement, project["dependencies"]), *shipped]:
        operators = {specifier.operator for specifier in requirement.specifier}
        assert operators == {">=", "<"}, requirement
