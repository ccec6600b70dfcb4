"""`doctor` names what is missing and the remedy; exit code 1 when a default run cannot work."""

from __future__ import annotations

import shutil
import sys
import tomllib
from importlib.metadata import packages_distributions
from itertools import chain
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from calm_edge.backbones.onnx import model_folder
from calm_edge.cli import main
from calm_edge.commands.doctor import NEEDED, OPTIONAL, installed


def findings(out: Path, capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    """The exit code and what is printed."""
    return main(["doctor", "--out", str(out)]), capsys.readouterr().out


def test_doctor_finds_nothing_fatal_here(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, text = findings(tmp_path, capsys)
    assert code == 0 and "missing" not in text.replace("nothing is missing", "")


@pytest.mark.parametrize(
    ("module", "code", "words"),
    [
        (
            "onnxruntime",
            1,
            "missing  onnxruntime: not installed: no networks; only the backbone without",
        ),
        ("depthai", 0, "note     depthai: not installed: no OAK cameras"),
        ("lz4", 1, "missing  lz4: not installed: no recording"),
    ],
)
def test_a_module_that_is_not_installed(
    module: str,
    code: int,
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    found, text = findings(tmp_path, capsys)
    assert found == code and words in text


def test_a_module_of_a_missing_package_is_not_installed() -> None:
    assert not installed("no_such_package.module") and installed("google.protobuf")


def test_every_declared_dependency_is_looked_for() -> None:
    root = Path(__file__).resolve().parents[2]
    project = tomllib.loads((root / "pyproject.toml").read_text())["project"]
    of_module = packages_distributions()
    looked_for = {module.partition(".")[0] for module in (*NEEDED, *OPTIONAL)}
    found = {canonicalize_name(name) for m in looked_for for name in of_module.get(m, ())}
    extras = [each for key, each in project["optional-dependencies"].items() if key != "dev"]
    declared = [Requirement(text).name for text in chain(project["dependencies"], *extras)]
    missing = {canonicalize_name(name) for name in declared} - found
    # built from source, so not installed everywhere
    assert missing <= {"systemd-python"}


def test_a_damaged_network_is_fatal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(model_folder.SHIPPED, tmp_path / "models")
    monkeypatch.setattr(model_folder, "SHIPPED", tmp_path / "models")
    with (tmp_path / "models/calm-geo/refine.onnx").open("ab") as file:
        file.write(b"!")
    code, text = findings(tmp_path, capsys)
    assert code == 1 and "refine.onnx: sha256 is" in text and "backbone.name=bundle" in text
