from dataclasses import replace

import numpy as np
import pytest

from bench.__main__ import main
from bench.kilometres import drives, predictions, runs
from bench.kilometres.lenses import barrel
from bench.kilometres.streams import Streams
from bench.scripted import ScriptedErrors
from calm_edge.config import Config
from tests.bench.scripted.street_drive import street


@pytest.fixture(scope="module")
def drive():
    return drives.cut("street", street(80, turn=0.01), Config(), Streams(), 0)


def test_without_errors_the_localizer_drives_the_truth(drive, tmp_path):
    backbone = predictions.cached(drive, ScriptedErrors(coupled=True), tmp_path)
    outcome = runs.run(drive, backbone, runs.Variant("ours"))
    assert outcome.ate_se3_m < 0.01 and outcome.ate_sim3_m < 0.01
    assert outcome.missing == 0 and outcome.n_submaps == len(drive.windows)
    assert outcome.percent == pytest.approx(100 * outcome.ate_sim3_m / drive.path_m)


def test_a_variant_changes_the_config_and_nothing_else(drive, tmp_path):
    dials = ScriptedErrors(coupled=True, scale_log_sigma=0.2)
    backbone = predictions.cached(drive, dials, tmp_path)
    ours = runs.run(drive, backbone, runs.Variant("ours"))
    unscaled = runs.run(drive, backbone, runs.Variant("raw", {"scale": {"rectify": False}}))
    assert ours.ate_se3_m < 0.01 < 0.1 < unscaled.ate_se3_m


def test_a_calibrated_lens_straightens_the_drive(tmp_path):
    bent = replace(street(80, turn=0.02), cameras=tuple(map(barrel, street(80).cameras)))
    drive = drives.cut("bent", bent, Config(), Streams(), 0)
    backbone = predictions.cached(drive, ScriptedErrors(coupled=True), tmp_path)
    ours = runs.run(drive, backbone, runs.Variant("ours"))
    calibrated = runs.run(drive, backbone, runs.Variant("calibrated", calibrated=True))
    assert calibrated.focal_percent < 0.5 < 2 < ours.focal_percent
    assert calibrated.ate_sim3_m < 0.05 < ours.ate_sim3_m


def test_another_aligner_takes_the_localizers_place(drive, tmp_path):
    def shrunk(drive, backbone, config, loops):
        T = drive.T_w_p[2:].copy()
        T[:, :3, 3] *= 0.9
        return np.arange(2, len(drive.keyframes)), T

    backbone = predictions.cached(drive, ScriptedErrors(coupled=True), tmp_path)
    outcome = runs.run(drive, backbone, runs.Variant("shrunk", aligner=shrunk))
    assert outcome.ate_sim3_m < 1e-6 < 0.5 < outcome.ate_se3_m
    assert outcome.missing == 2


def test_no_pose_is_an_infinite_error(drive, tmp_path):
    def nothing(drive, backbone, config, loops):
        return np.zeros(0, np.int64), np.zeros((0, 4, 4))

    backbone = predictions.cached(drive, ScriptedErrors(coupled=True), tmp_path)
    assert runs.run(drive, backbone, runs.Variant("nothing", aligner=nothing)).ate_se3_m == np.inf


def test_the_command_says_in_one_line_what_is_not_here(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(drives, "TRAJECTORIES", tmp_path)
    assert main(["kilometres", "--sequences", "00"]) == 1
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.skipif(not drives.TRAJECTORIES.is_dir(), reason="no trajectories here")
def test_the_command_prints_a_row_a_drive(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(predictions, "CACHE", tmp_path)
    assert main(["kilometres", "--sequences", "04", "--frames", "60"]) == 0
    said = capsys.readouterr().out
    assert "04" in said and "mean" in said


def test_streams_out_of_step_are_driven_as_well(tmp_path):
    scene = street(120, turn=0.01)
    drive = drives.cut("alternate", scene, Config(), Streams(alternate=True), 0)
    window = drive.windows[1]
    stamps = [[k.frame.t_ns for k in eye] for eye in (window.primary, window.assistant)]
    assert not set(stamps[0]) & set(stamps[1])
    backbone = predictions.cached(drive, ScriptedErrors(coupled=True), tmp_path)
    outcome = runs.run(drive, backbone, runs.Variant("ours"))
    assert outcome.missing == 0 and outcome.percent < 0.1


def test_true_stamps_are_not_needed_for_true_poses(tmp_path):
    scene = street(60)
    streams = Streams(late_s=(0.03, 0.03), jitter_s=0.004)
    drive = drives.cut("late", scene, Config(), streams, 0)
    backbone = predictions.cached(drive, ScriptedErrors(coupled=True), tmp_path)
    # pictures show the true exposures; only values computed from stamps have a small error
    outcome = runs.run(drive, backbone, runs.Variant("ours"))
    assert 1e-6 < outcome.ate_sim3_m < 0.1
