"""Files and pages of a map of several drives, of recordings whose true poses are known."""

from __future__ import annotations

import json
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from calm_edge.commands import joined_outputs
from calm_edge.commands.drive_reference import DriveReference
from calm_edge.commands.exit_codes import LOSS
from calm_edge.commands.joined_outputs import write
from calm_edge.commands.map_pages import Options
from calm_edge.config import Config, merge
from calm_edge.evaluation.estimate import from_map
from calm_edge.evaluation.truth import Truth
from calm_edge.geometry import body_frame, local_enu, se3
from calm_edge.interchange.export.drive import read_drive
from calm_edge.mapping.cloud_file import CloudWriter
from calm_edge.offline.drive import Drive
from calm_edge.offline.gps_fixes import GpsFixes
from calm_edge.offline.joined_drives import Joined
from calm_edge.offline.shared_places import STRIDE
from calm_edge.recording.reader import Recording
from calm_edge.recording.window_record import WindowRecord
from calm_edge.types import MapTile, Metre
from device.frame import Eye
from tests.interchange.export.drives import (
    EVERY,
    FRAMES,
    LENSES,
    ORIGIN_NS,
    true_poses,
    true_times,
    update,
    write_recording,
)

NAMES = ["monday", "tuesday", "friday"]
ORIGIN = np.array([48.1, 11.5, 500.0])


@pytest.fixture
def parts(tmp_path: Path) -> list[Any]:
    """Three drives; the last one knows no metre."""
    found = []
    for name in NAMES:
        recording = Recording(write_recording(tmp_path / name))
        solved = update(LENSES, 0.01)
        metre = Metre(reason="too straight") if name == "friday" else Metre(0.01)
        submap = solved.submap
        n = len(submap.t_ns)
        window = WindowRecord(
            *(0, submap.n_primary, 0, False),
            ids=np.arange(n),
            eyes=np.repeat([Eye.PRIMARY, Eye.ASSISTANT], [submap.n_primary, n - submap.n_primary]),
            sequences=np.tile(np.arange(0, FRAMES, EVERY), 2),
            t_ns=submap.t_ns,
        )
        drive = Drive([window], [solved], solved.trajectory, metre=metre)
        config = merge(Config(), {"scale": {"spacing_m": 0.5}})
        placed = SimpleNamespace(recording=recording, drive=drive)
        found.append(SimpleNamespace(placed=placed, config=config))
    return found


def cloud(out: Path, points: dict[int, int]) -> np.ndarray:
    """Write the given number of points for each drive; points of drive n have z = n."""
    rows = []
    with CloudWriter(out / "map.ply") as file:
        for n, count in points.items():
            p = np.random.default_rng(n).uniform(-5, 5, (count, 3)).astype(np.float32)
            p[:, 2] = n
            file.write(MapTile(p, np.full((count, 3), 40 * n, np.uint8)))
            rows.append((STRIDE * n, count))
    return np.array(rows, np.int64)


def fixes(recording: Recording) -> GpsFixes:
    """Fixes at every frame of the drive, with its stamps, 5 cm wrong."""
    flat = body_frame.FLU_FROM_FRD @ body_frame.mounting((0.0, 0.0, 0.0))
    enu = (flat @ true_poses())[:, :3, 3] + np.random.default_rng(1).normal(0, 0.05, (24, 3))
    lla = local_enu.geodetic(enu, ORIGIN)
    sigma = np.full(lla.shape, 0.05)
    return GpsFixes(recording.path, true_times() - ORIGIN_NS, lla, sigma, 0)


def test_all_files_of_joined_drives_and_of_one_that_is_apart(
    parts: list[Any],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "out"
    (out / "drives" / "stale").mkdir(parents=True)
    joined = Joined(
        {n: parts[n].placed.drive for n in (0, 1)}, (2,), {(0, 1): 4}, {0: 1.0, 1: 1.01}
    )
    monkeypatch.setattr(joined_outputs, "fused", lambda *_: (cloud(out, {0: 300, 1: 200}), ()))
    # in a frame that is not that of the first keyframe
    T_t_w = se3.exp(np.array([3.0, -2, 1, 0.2, 0.1, -0.4]))
    truth = Truth(true_times() - ORIGIN_NS, T_t_w @ true_poses())
    given = [DriveReference(truth, fixes(part.placed.recording)) for part in parts]
    options = Options("preview", pictures=False)
    assert write(parts, NAMES, given, joined, out, tmp_path / "scratch", options) == LOSS
    shown, losses = capsys.readouterr()
    assert re.search(r"error       0\.0\d\d m \(rms\) in one frame: monday 0\.0\d\d m, tue", shown)
    assert "joined      monday and tuesday by 4 places" in shown and "500 points" in shown
    assert "loss: friday: is apart" in losses and "friday: no metre: too straight" in losses
    own = {"trajectory.tum", "trajectory.kitti", "summary.json", "report.html", "submaps"}
    for name in NAMES:
        # the one that is apart is placed by its own fixes
        assert {p.name for p in (out / "drives" / name).iterdir()} == own | {
            "trajectory.enu.tum",
            "gps.json",
        }
    assert not (out / "drives" / "stale").exists()
    summary = json.loads((out / "summary.json").read_text())
    assert [row["apart"] for row in summary["drives"]] == [False, False, True]
    assert summary["drives"][1]["scale"] == 1.01 and summary["quality"] == "preview"
    assert 0 < summary["error"]["ate_m"] < 0.1 and len(summary["error"]["by_drive"]) == 2
    gps = json.loads((out / "gps.json").read_text())
    assert [row["name"] for row in gps["drives"]] == ["monday", "tuesday"]
    assert gps["used"] >= 30 and gps["residual_rms_m"] < 0.15
    page = (out / "map.html").read_text()
    assert '"drives":[["monday",0],["tuesday",6]]' in page and '"count":500' in page
    report = (out / "report.html").read_text()
    assert "friday: is apart" in report and 'href="drives/friday/report.html"' in report
    # each drive has its own points and errors in its report, the map has all points
    assert "trajectory error" in (out / "drives/friday/report.html").read_text()
    assert "300 points" in (out / "drives/monday/report.html").read_text()
    points = from_map(out).points_w
    assert points is not None and len(points) == 500
    place = read_drive(out).place
    assert place is not None and abs(place.origin[:2] - ORIGIN[:2]).max() < 1e-3
    # as after an import, whose recording holds no sub-map
    for folder in (out, out / "drives/tuesday"):
        assert read_drive(folder).last.submap.id == 0
        assert read_drive(folder).solved.path.name == "submaps"
