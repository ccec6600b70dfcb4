"""`doctor` names what is missing and the remedy; exit code 1 when a default run cannot work."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import pytest

from calm_edge.backbones.onnx import model_folder
from calm_edge.cli import main


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
        ("matplotlib", 0, "note     matplotlib: not installed: no report.html"),
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


def test_a_damaged_network_is_fatal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(model_folder.SHIPPED, tmp_path / "models")
    monkeypatch.setattr(model_folder, "SHIPPED", tmp_path / "models")
    with (tmp_path / "models/calm-geo/refine.onnx").open("ab") as file:
        file.write(b"!")
    code, text = findings(tmp_path, capsys)
    assert code == 1 and "refine.onnx: sha256 is" in text and "backbone.name=bundle" in text
