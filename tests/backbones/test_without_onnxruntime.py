"""Plain `bundle` on a machine without ONNX Runtime, in every process of a drive."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

DRIVE = Path(__file__).parents[2] / "demo" / "drive"
FRAMES = 20


@pytest.fixture
def calm_edge(tmp_path):
    """Runs `calm-edge` so that none of its processes can import onnxruntime."""
    blocked = tmp_path / "blocked"
    blocked.mkdir()
    (blocked / "sitecustomize.py").write_text("import sys; sys.modules['onnxruntime'] = None\n")
    path = os.pathsep.join([str(blocked), *os.environ.get("PYTHONPATH", "").split(os.pathsep)])

    def run(*arguments):
        return subprocess.run(
            [sys.executable, "-m", "calm_edge.cli", *map(str, arguments)],
            env={**os.environ, "PYTHONPATH": path},
            capture_output=True,
            text=True,
        )

    return run


@pytest.fixture
def drive(tmp_path):
    """Sequence folder with the first two seconds of the demo drive."""
    for eye in (0, 1):
        (tmp_path / f"drive/cam{eye}").mkdir(parents=True)
        for picture in sorted((DRIVE / f"cam{eye}").iterdir())[:FRAMES]:
            shutil.copy(picture, tmp_path / f"drive/cam{eye}")
        times = (DRIVE / f"times{eye}.txt").read_text().splitlines()[:FRAMES]
        (tmp_path / f"drive/times{eye}.txt").write_text("\n".join(times))
    return tmp_path / "drive"


def test_a_drive_is_recorded_and_mapped_with_plain_bundle(calm_edge, drive, tmp_path):
    assert "onnxruntime: not installed" in calm_edge("doctor", "--out", tmp_path).stdout
    recording, made = tmp_path / "recording", tmp_path / "map"
    recorded = calm_edge(
        "record", "--sequence", drive, "--out", recording, "--pace", "lockstep",
        "--set", "backbone.name=bundle", "--set", "frontend.n_max=6",
        # with the field of view, so that the solver tries fewer focal lengths
        "--set", "backbone.hfov_deg=[78,110]",
    )  # fmt: skip
    assert recorded.returncode == 0, recorded.stderr
    mapped = calm_edge("map", recording, "--out", made)
    assert mapped.returncode == 0, mapped.stderr
    assert len(np.loadtxt(made / "trajectory.tum")) > FRAMES // 3
    assert (made / "map.ply").stat().st_size > 10_000


@pytest.mark.parametrize("name", ["calm-geo", "bundle:calm-geo"])
def test_a_network_is_refused_in_one_line(calm_edge, drive, tmp_path, name):
    refused = calm_edge(
        "record", "--sequence", drive, "--out", tmp_path / "recording", "--pace", "lockstep",
        "--set", f"backbone.name={name}",
    )  # fmt: skip
    assert refused.returncode != 0
    line = next(line for line in refused.stderr.splitlines() if "onnxruntime" in line)
    assert "not installed" in line and "backbone.name=bundle" in line
    assert "Traceback" not in refused.stderr
