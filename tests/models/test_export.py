"""Export of the authors' networks: parity at any number of views, and `model check` passes.

Needs torch and the authors' code: checkouts vggt, pi3, mapanything and dinov2 in the folder of the
environment variable CALM_EDGE_AUTHORS_CODE, and the package depth-anything-3. Weights are random
except for the last layers, which are fitted to one known scene (tests/models/known_scene.py).
"""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from calm_edge.backbones.feedforward.backbone import FeedforwardBackbone
from calm_edge.backbones.model_check.check import check
from calm_edge.backbones.model_check.probe import Limits
from calm_edge.backbones.onnx.model_folder import EXPORTED, read_manifest
from calm_edge.types import Hints

CODE = Path(os.environ.get("CALM_EDGE_AUTHORS_CODE", "nowhere"))
PARITY = re.compile(
    r"^(\d+) views: ONNX against torch, largest error (\S+) of the spread", re.MULTILINE
)
VIEWS = 6


def export(name: str, out: Path, *more: str) -> str:
    """Output of export.py, run in a separate process since it changes the authors' classes."""
    script = Path(__file__).with_name("known_scene.py")
    given = [name, "--pictures", str(out / "pictures"), "--out", str(out), "--max-views", "6"]
    done = subprocess.run(
        [sys.executable, str(script), *given, *more], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("name", ["da3", "vggt", "pi3", "mapanything"])
def test_the_graph_equals_the_network_and_passes_the_check(name, tmp_path):
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
    said = export(name, tmp_path, *more)
    print(said)
    errors = {int(n): float(error) for n, error in PARITY.findall(said)}
    assert set(errors) == {2, 3, 6}
    assert max(errors.values()) <= 1e-4
    manifest = read_manifest(tmp_path)
    report = check(manifest, Limits(60.0, 8000.0, (56, 42)), print)
    assert not report.refusal
    for seen in report.reprojection.values():
        print(seen)
        assert seen.disagreement < 0.15 and seen.inverted > 1.5 * seen.disagreement
    assert report.max_views == {"fp32": VIEWS}
    a_longer_window_is_split_and_joined(manifest, tmp_path / "pictures")


def a_longer_window_is_split_and_joined(manifest, pictures) -> None:
    """Six views in parts of four that overlap by two, compared with the scene and a single run."""
    from tests.models.known_scene import scene

    images = [cv2.imread(str(pictures / f"{view}.png")) for view in range(VIEWS)]
    hints = Hints(eyes=np.zeros(VIEWS, np.int64), t_ns=np.arange(VIEWS) * 100_000_000)
    whole = FeedforwardBackbone(manifest, "fp32", VIEWS).infer(images, hints)
    split = FeedforwardBackbone(manifest, "fp32", 4).infer(images, hints)
    assert not whole.notices
    assert [n for n in split.notices if f"{manifest.name} takes 4 views" in n]
    truth = scene().T_s_c()
    for found in (whole, split):
        off = np.linalg.norm(found.T_s_c[:, :3, 3] - truth[:, :3, 3], axis=1)
        print(off.max(), np.abs(found.T_s_c[:, :3, :3] - truth[:, :3, :3]).max())
        assert off.max() < 0.1 * np.linalg.norm(truth[-1, :3, 3])
        assert found.T_s_c[:, :3, :3] == pytest.approx(truth[:, :3, :3], abs=0.05)
    ratio = np.median((split.depth / whole.depth).reshape(VIEWS, -1), axis=1)
    assert ratio == pytest.approx(np.ones(VIEWS), abs=0.1)


def test_without_the_authors_code_there_is_an_error_of_one_line(tmp_path):
    pytest.importorskip("torch")
    pytest.importorskip("onnxruntime")
    command = [sys.executable, str(EXPORTED / "vggt/export.py"), "--random-weights"]
    command += ["--repo", str(tmp_path), "--out", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1].startswith("the authors' code is missing: no module vggt")
    assert "Traceback" not in done.stderr
