import dataclasses

import numpy as np
import pytest

from calm_edge.backbones.scripted import ScriptedErrors
from calm_edge.config import Config
from calm_edge.evaluation.kilometres import drives, predictions, runs
from calm_edge.evaluation.kilometres.loops import ScriptedLoops
from calm_edge.evaluation.kilometres.rivals import rival
from calm_edge.evaluation.kilometres.streams import Streams
from tests.backbones.scripted.street_drive import street
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
