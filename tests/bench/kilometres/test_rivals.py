import dataclasses

import numpy as np
import pytest

from bench.kilometres import drives, predictions, runs
from bench.kilometres.loops import ScriptedLoops
from bench.kilometres.rivals import HeldViews, rival
from bench.kilometres.streams import Streams
from bench.scripted import ScriptedErrors
from calm_edge.config import Config
from tests.bench.scripted.street_drive import street
from tests.drives import PERIOD_NS, START_NS, circle


@pytest.fixture(scope="module")
def drive():
    return drives.cut("street", street(70, turn=0.01), Config(), Streams(), 0)


@pytest.mark.parametrize("name", ["sim3", "sl4"])
def test_without_errors_a_baseline_finds_the_path(drive, tmp_path, name):
    backbone = predictions.cached(
        drive, ScriptedErrors(coupled=True, scale_log_sigma=0.3), tmp_path
    )
    outcome = runs.run(drive, backbone, rival(name))
    assert outcome.ate_sim3_m < 0.05 and outcome.missing == 0


def test_depth_that_drifts_against_poses_is_the_baselines_scale_drift(drive, tmp_path):
    dials = ScriptedErrors(coupled=True, depth_drift=0.1)
    backbone = predictions.cached(drive, dials, tmp_path)
    ours, theirs = (runs.run(drive, backbone, v) for v in (runs.Variant("ours"), rival("sim3")))
    assert ours.ate_sim3_m < 0.01 < 0.1 < theirs.ate_sim3_m


def test_loops_pull_a_baseline_together(tmp_path):
    T = np.concatenate([circle(100, 20.0)] * 2)[:130]
    scene = dataclasses.replace(
        street(130), T_w_p=T, t_ns=START_NS + PERIOD_NS * np.arange(len(T)), street=None
    )
    drive = drives.cut("circle", scene, Config(), Streams(), 0)
    backbone = predictions.cached(drive, ScriptedErrors(coupled=True, depth_drift=0.1), tmp_path)
    apart = runs.run(drive, backbone, rival("sim3"))
    loops = ScriptedLoops(drive, min_gap=60, detection=1.0)
    closed = runs.run(drive, backbone, rival("sim3"), loops=loops)
    assert closed.ate_sim3_m < 0.7 * apart.ate_sim3_m


def test_both_baselines_share_one_drives_depth(drive, tmp_path, monkeypatch):
    dials = ScriptedErrors(coupled=True, scale_log_sigma=0.3, depth_drift=0.05)
    backbone = predictions.cached(drive, dials, tmp_path)
    apart = [runs.run(drive, backbone, rival(name)) for name in ("sim3", "sl4")]
    made = []
    depth = predictions.CachedBackbone.depth

    def counted(self, hints, views):
        made.append(len(views))
        return depth(self, hints, views)

    monkeypatch.setattr(predictions.CachedBackbone, "depth", counted)
    held = HeldViews()
    shared = [runs.run(drive, backbone, rival("sim3", held))]
    of_one = sum(made)
    shared.append(runs.run(drive, backbone, rival("sl4", held)))
    assert sum(made) == of_one > 0
    for a, b in zip(apart, shared, strict=True):
        np.testing.assert_array_equal(a.T_w_p, b.T_w_p)
