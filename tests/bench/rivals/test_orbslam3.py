"""Input of ORB-SLAM3, frame by frame; needs no installation of it."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.rivals import orbslam3
from bench.rivals.calibration import Calibration, true_calibration
from bench.rivals.environment import RivalRun
from bench.rivals.orbslam3_process import read_final
from calm_edge.geometry import se3
from calm_edge.geometry.camera import Perspective
from tests.bench.rivals.test_calibration import RIG, write


def test_its_settings_hold_the_whole_kit() -> None:
    size = 640, 240
    cameras = Perspective(500, 501, 320, 120, *size), Perspective(600, 601, 310, 125, *size)
    text = orbslam3.settings(Calibration(cameras, RIG, size), 10.0)
    value = dict(re.findall(r"^([\w.]+): ([-\d.e]+)$", text, re.MULTILINE))
    for eye, camera in enumerate(cameras, 1):
        said = [float(value[f"Camera{eye}.{key}"]) for key in ("fx", "fy", "cx", "cy")]
        assert said == [camera.fx, camera.fy, camera.cx, camera.cy]
    assert (value["Camera.width"], value["Camera.height"]) == ("640", "240")
    assert value["loopClosing"] == "0"
    (data,) = re.findall(r"data: \[(.*)\]", text)
    np.testing.assert_allclose(np.fromstring(data, sep=",").reshape(4, 4), RIG, atol=1e-11)


@pytest.mark.parametrize("shift", [0, 1])
def test_its_job_pairs_the_pictures_and_keeps_our_stamps(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shift: int
) -> None:
    folder = write(tmp_path / "d")
    jobs: list[dict[str, Any]] = []

    def note(_python: Path, script: Path, job: dict[str, Any], work: Path) -> RivalRun:
        assert script.is_file() and Path(job["settings"]).parent == work
        jobs.append(job)
        return RivalRun(np.zeros(0, np.int64), np.zeros((0, 4, 4)), 0, 0.0, 0.0)

    monkeypatch.setattr(orbslam3, "environment", lambda *_: Path("python"))
    monkeypatch.setattr(orbslam3, "vocabulary_of", lambda _pictures, where: where)
    monkeypatch.setattr(orbslam3, "run_process", note)
    orbslam3.run(folder, true_calibration(folder), tmp_path / "w", shift)
    pairs = jobs[0]["pairs"]
    assert len(pairs) == 60 - shift
    for k in (0, 5):
        left, right, t_ns = pairs[k]
        assert left.endswith(f"cam0/{k:06d}.png") and right.endswith(f"cam1/{k + shift:06d}.png")
        assert t_ns == 10**9 + k * 10**8


def test_its_final_poses_are_read_back_to_their_stamps(tmp_path: Path) -> None:
    q = se3.quaternions(RIG[None, :3, :3])[0]
    values = " ".join(f"{v:.9f}" for v in (*RIG[:3, 3], *q))
    (tmp_path / "f.txt").write_text(f"1100000000.000119 {values}\n")
    found = read_final(tmp_path / "f.txt", [10**9, 1_100_000_000])
    assert list(found) == [1_100_000_000]
    np.testing.assert_allclose(found[1_100_000_000], RIG, atol=1e-8)
    assert read_final(tmp_path / "gone.txt", [1]) == {}
