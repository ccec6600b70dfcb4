"""Files written by version 0.1.0 at commit ad6601c, before cameras had a model, still open.

tests/data: `recording/` of 14 frames an eye with the scripted backbone, which plays the truth in
`drive/`; `map_trajectory.tum`, what `map` then wrote of it; `kit.json` of 51 frames with `bundle`.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from calm_edge.backbones.registry import open_backbone
from calm_edge.cli import main
from calm_edge.estimator.localizer import Localizer
from calm_edge.geometry.camera import Perspective
from calm_edge.kit import file, layout
from calm_edge.offline.submaps import gather
from calm_edge.recording.reader import Recording
from calm_edge.trajectories import read_tum

ROOT = Path(__file__).parents[1]
DATA = ROOT / "tests" / "data"


@pytest.fixture
def recording(monkeypatch: pytest.MonkeyPatch) -> Recording:
    # the recorded configuration names the truth's folder from the root of the repository
    monkeypatch.chdir(ROOT)
    return Recording(DATA / "recording")


def test_sub_maps_are_those_that_were_logged(recording: Recording) -> None:
    drive = gather(recording, recording.config, lambda _: None)
    assert not recording.losses and not drive.losses
    assert [update.submap.id for update in drive.updates] == [0, 1]
    t_ns, T_w_c = read_tum(DATA / "map_trajectory.tum")
    assert drive.trajectory is not None
    np.testing.assert_array_equal(drive.trajectory.t_ns, t_ns)
    np.testing.assert_allclose(drive.trajectory.T_w_c, T_w_c, atol=1e-8)
    *optics, width, height = np.loadtxt(DATA / "drive" / "calib.txt")[0].tolist()
    camera = Perspective(*optics, int(width), int(height))
    for update in drive.updates:
        assert update.submap.cameras == update.submap.cameras_raw == (camera,) * 6
        assert update.prediction.cameras == (camera,) * 6


def test_windows_solved_again_are_the_same_sub_maps(recording: Recording) -> None:
    localizer = Localizer(recording.config, open_backbone(recording.config))
    logged = {update.submap.id: update.submap for update in recording.updates()}
    for record in recording.windows():
        update = localizer.process(recording.window(record))
        assert update is not None
        np.testing.assert_allclose(
            update.submap.T_s_c_raw, logged[record.submap_id].T_s_c_raw, atol=1e-9
        )
        np.testing.assert_allclose(update.submap.T_w_s, logged[record.submap_id].T_w_s, atol=1e-9)
    assert len(localizer.submaps) == len(logged) == 2


def test_map_of_the_recording(recording: Recording, tmp_path: Path) -> None:
    # 3: the recording does not say whether its lengths are metric
    assert main(["map", str(recording.path), "--out", str(tmp_path)]) == 3
    ours, theirs = (read_tum(f) for f in (tmp_path / "trajectory.tum", DATA / "map_trajectory.tum"))
    np.testing.assert_array_equal(ours[0], theirs[0])
    np.testing.assert_allclose(ours[1], theirs[1], atol=1e-8)
    assert json.loads((tmp_path / "summary.json").read_text())["submaps"] == 2
    assert (tmp_path / "map.ply").stat().st_size > 20_000


def test_kit_file() -> None:
    kept = file.read(DATA / "kit.json")
    sizes = np.array([[1226, 370], [1226, 370]])
    belief, why = file.remembered(DATA / "kit.json", kept, ("v4l2:", "v4l2:"), sizes)
    assert belief is not None and not why
    focal_px = np.exp(belief.mean[list(layout.LOG_FOCAL)]) * 1226
    # the focal of the drive's calibration
    np.testing.assert_allclose(focal_px, 707.0912, rtol=0.05)
