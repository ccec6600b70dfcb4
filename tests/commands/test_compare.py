"""`compare` of recordings, maps and TUM files: text, JSON and page."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from calm_edge.cli import main
from calm_edge.config import Config, merge
from calm_edge.recording.writer import RecordingWriter
from calm_edge.trajectories import write_kitti, write_tum
from device.frame import Eye, Frame, jpeg
from tests.evaluation.worlds import curve, stamps, update

N = 40


def recording(folder: Path, focal: float, drops: int = 0, truth: bool = False) -> Path:
    """A recording of a drive of N keyframes in one update."""
    writer = RecordingWriter(
        folder,
        merge(Config(), {"scale": {"spacing_m": 0.5}}),
        {"source": "cameras", "pace": "realtime", "backbone": "bundle"},
        lossless=True,
    )
    picture = jpeg(np.zeros((8, 8, 3), np.uint8))
    for eye in Eye:
        for k, t_ns in enumerate(stamps(N).tolist()):
            writer.write_frame(Frame(eye, k, t_ns, picture))
    writer.write_update(update(curve(N), stamps(N), (focal, 600.0), stage_ms={"infer": 90.0}))
    writer.write_status({"finished": True, "camera_drops": drops, "lost_poses": 3})
    writer.close()
    if truth:
        (folder / "truth").mkdir()
        write_kitti(folder / "truth" / "poses0.txt", curve(N))
        np.savetxt(folder / "truth" / "times0.txt", stamps(N) / 1e9, fmt="%.6f")
    return folder


def a_map(folder: Path) -> Path:
    folder.mkdir()
    write_tum(folder / "trajectory.tum", stamps(N), curve(N))
    summary = {
        "spacing_m": 0.5,
        "metre": {"sigma_percent": 1.0, "reason": ""},
        "focal_px": [510.0, 600.0],
        "focal_sigma_percent": [1.0, None],
        "T_p_a": np.eye(4).tolist(),
        "map_s": {"depth": 61.5},
        "seams": {"median_before": 0.2, "median_after": 0.1},
        "gaps": [],
    }
    (folder / "summary.json").write_text(json.dumps(summary))
    return folder


def test_two_recordings(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    a = recording(tmp_path / "a", 500.0, truth=True)
    b = recording(tmp_path / "b", 505.0, drops=4)
    page = tmp_path / "page.html"
    assert main(["compare", str(a), str(b), "--out", str(page)]) == 0
    text = capsys.readouterr().out
    lines = {line.split("  ")[0]: line for line in text.splitlines() if line}
    assert "500 px" in lines["focal length, primary"] and "+5 (+1 %)" in text
    assert lines["camera drops"].split()[2:] == ["0", "4", "+4"]
    assert f"{N} keyframes with common stamps" in text
    # the truth of an imported recording is found by itself
    assert "trajectory error, SE(3)" in text
    html = page.read_text()
    assert "Both paths from above" in html and html.count("<polyline") == 4
    assert main(["compare", str(a), str(b), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["difference"]["focal_primary_px"] == 5.0
    assert found["a"]["stage_ms.infer"] == 90.0 and found["a"]["ate_se3_m"] < 1e-6
    assert "ate_se3_m" not in found["b"]


def test_a_map_and_a_tum_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    a, b = a_map(tmp_path / "map"), tmp_path / "other.tum"
    write_tum(b, stamps(N), curve(N))
    assert main(["compare", str(a), str(b), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["a"]["kind"] == "map" and found["b"]["kind"] == "trajectory"
    assert found["a"]["map_s.depth"] == 61.5 and found["a"]["rig_rotation_x_deg"] == 0.0
    assert found["paths"]["rms"] < 1e-6


def test_a_truth_of_another_drive_is_a_loss(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    a = a_map(tmp_path / "map")
    (tmp_path / "truth").mkdir()
    write_kitti(tmp_path / "truth" / "poses0.txt", curve(N))
    np.savetxt(tmp_path / "truth" / "times0.txt", stamps(N) / 1e9 + 5000, fmt="%.6f")
    assert main(["compare", str(a), str(a), "--truth", str(tmp_path / "truth")]) == 3
    assert "not compared with the truth" in capsys.readouterr().err
    assert main(["compare", str(a), str(tmp_path / "none")]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "none: no such recording" in line
