"""The authors' own networks at small width, random weights: the graph is the network at any N.

Runs where torch and the code are: checkouts named after the model in the folder that the variable
CALM_EDGE_AUTHORS_CODE names (vggt, pi3, mapanything, dinov2); DA3 as the package depth-anything-3.
"""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from calm_edge.backbones.model_folder import MODELS, read_manifest, verify

CODE = Path(os.environ.get("CALM_EDGE_AUTHORS_CODE", "nowhere"))
PARITY = re.compile(
    r"^(\d+) views: ONNX against torch, worst value (\S+) of its spread", re.MULTILINE
)


def export(name: str, out: Path, *more: str) -> str:
    """Output of export.py in a process of its own: it changes the authors' classes."""
    script = MODELS / name / "export.py"
    size = ["--random-weights", "--size", "56x42", "--out", str(out)]
    done = subprocess.run(
        [sys.executable, str(script), *size, *more], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


@pytest.mark.parametrize("name", ["da3", "vggt", "pi3", "mapanything"])
def test_the_graph_is_the_network(name, tmp_path):
    for module in ("torch", "onnxscript", "onnxruntime"):
        pytest.importorskip(module)
    if name == "da3":
        if importlib.util.find_spec("depth_anything_3") is None:
            pytest.skip("depth-anything-3 is not installed")
        more = []
    else:
        if not (CODE / name).is_dir():
            pytest.skip(f"no checkout of {name}; see CALM_EDGE_AUTHORS_CODE above")
        more = ["--repo", str(CODE / name), "--small"]
    if name == "mapanything":
        pytest.importorskip("uniception")
        more += ["--dinov2", str(CODE / "dinov2")]
    errors = {int(n): float(error) for n, error in PARITY.findall(export(name, tmp_path, *more))}
    assert set(errors) == {2, 3, 6}
    assert max(errors.values()) <= 1e-4
    assert verify(read_manifest(tmp_path)) == 2


def test_without_the_authors_code_there_is_one_line(tmp_path):
    pytest.importorskip("torch")
    pytest.importorskip("onnxruntime")
    command = [sys.executable, str(MODELS / "vggt/export.py"), "--random-weights"]
    command += ["--repo", str(tmp_path), "--out", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1].startswith("the author's code is not there: no module vggt")
    assert "Traceback" not in done.stderr
