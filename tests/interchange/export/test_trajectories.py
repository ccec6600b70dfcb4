"""Exported trajectories: read by our readers, and by evo where it is installed."""

from __future__ import annotations

import csv
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from calm_edge.evaluation import trajectory
from calm_edge.evaluation.results import evaluate
from calm_edge.evaluation.truth import read_truth
from calm_edge.geometry import se3
from calm_edge.geometry.similarity import align
from calm_edge.interchange.export.base import ExportOptions, Written
from calm_edge.interchange.export.drive import read_drive
from calm_edge.interchange.export.registry import EXPORTERS
from calm_edge.trajectories import read_kitti, read_tum, write_kitti, write_tum
from device.frame import Eye
from tests.interchange.export.drives import (
    EVERY,
    FRAMES,
    ORIGIN_NS,
    assistant_poses,
    true_poses,
    true_times,
    with_map,
    write_recording,
)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_recording(tmp_path_factory.mktemp("drive") / "rec")


@pytest.fixture(scope="module")
def truth(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """True poses that differ from the estimate by a turn of the world and by noise."""
    folder = tmp_path_factory.mktemp("truth")
    noise = np.random.default_rng(3).normal(0, 0.05, (FRAMES, 3))
    T = se3.exp(np.array([3.0, 1, 2, 0.2, 0.4, 0.1])) @ true_poses()
    T[:, :3, 3] += noise
    write_kitti(folder / "poses0.txt", T)
    own = (true_times() - ORIGIN_NS).tolist()
    (folder / "times0.txt").write_text("".join(f"{t / 1e9:.9f}\n" for t in own))
    return folder


def export(name: str, source: Path, folder: Path) -> Written:
    folder.mkdir()
    return EXPORTERS[name].write(read_drive(source), folder, ExportOptions())


def test_tum_has_every_frame_of_both_eyes_with_the_users_stamps(
    recording: Path, tmp_path: Path
) -> None:
    written = export("tum", recording, tmp_path / "out")
    true = {Eye.PRIMARY: true_poses(), Eye.ASSISTANT: assistant_poses()}
    for eye in Eye:
        t, T = read_tum(tmp_path / "out" / f"{eye.name.lower()}.tum")
        assert np.array_equal(t, true_times() - ORIGIN_NS)
        # after the last keyframe nothing corrects the live scale, which is 20 % off
        assert np.linalg.norm((T - true[eye])[:-4, :3, 3], axis=1).max() < 0.05
    assert any("24 poses: 6 keyframe, 9 tracked, 9 interpolated" in line for line in written.wrote)
    assert any("+20.0 ms" in line for line in written.assumed)


def test_the_ate_of_the_written_file_is_that_of_eval(
    recording: Path, truth: Path, tmp_path: Path
) -> None:
    export("tum", recording, tmp_path / "out")
    t, T = read_tum(tmp_path / "out" / "keyframes.tum")
    true = read_truth(truth)
    i, j = trajectory.associate(t + ORIGIN_NS, true.t_ns)
    p, p_true = T[i, :3, 3], true.T_w_c[j, :3, 3]
    ours = trajectory.ate(align(p, p_true, with_scale=False).points(p), p_true)
    figures = evaluate(recording, truth)
    assert len(i) == figures["poses"] == FRAMES // EVERY
    assert ours == pytest.approx(figures["ate_se3_m"], abs=1e-8)
    assert evaluate(tmp_path / "out" / "keyframes.tum", truth)["ate_se3_m"] == pytest.approx(
        ours, abs=1e-8
    )


@pytest.mark.skipif(shutil.which("evo_ape") is None, reason="evo is not installed (evo_ape)")
@pytest.mark.parametrize(("option", "key"), [("-a", "ate_se3_m"), ("-as", "ate_sim3_m")])
def test_evo_accepts_the_stamps_and_finds_the_ate_of_eval(
    option: str, key: str, recording: Path, truth: Path, tmp_path: Path
) -> None:
    export("tum", recording, tmp_path / "out")
    true = read_truth(truth)
    write_tum(tmp_path / "truth.tum", true.t_ns - ORIGIN_NS, true.T_w_c)
    estimate = tmp_path / "out" / "keyframes.tum"
    command = ["evo_ape", "tum", str(tmp_path / "truth.tum"), str(estimate), option]
    ran = subprocess.run(command, capture_output=True, text=True, check=True)
    found = re.search(r"rmse\s+([\d.]+)", ran.stdout)
    assert found is not None, ran.stdout
    assert float(found[1]) == pytest.approx(evaluate(recording, truth)[key], abs=2e-6)


def test_kitti_has_a_row_a_frame_and_lists_what_was_filled_in(tmp_path: Path) -> None:
    # without a tracker the frames after the last keyframe have no pose
    source = write_recording(tmp_path / "rec", live=[])
    written = export("kitti", source, tmp_path / "out")
    T = read_kitti(tmp_path / "out" / "primary.txt")
    assert len(T) == FRAMES and np.isfinite(T).all()
    lines = (tmp_path / "out" / "primary_filled_in.txt").read_text().splitlines()[1:]
    assert lines == ["21 2.100000000", "22 2.200000000", "23 2.300000000"]
    assert np.array_equal(T[21:], T[[20, 20, 20]])
    assert any(line.startswith("3 frames of the primary") for line in written.left_out)
    times = (tmp_path / "out" / "primary_times.txt").read_text().split()
    assert len(times) == FRAMES and times[:2] == ["0.000000000", "0.100000000"]


def test_csv_has_covariances_where_they_are_known(recording: Path, tmp_path: Path) -> None:
    export("csv", recording, tmp_path / "out")
    with (tmp_path / "out" / "primary.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["source"] for row in rows][:5] == ["keyframe", *["interpolated"] * 3, "keyframe"]
    assert rows[0]["cov_x_x"] == "" and rows[15]["cov_rz_rz"] == ""
    assert float(rows[4]["cov_x_x"]) == pytest.approx(1e-4)
    assert float(rows[8]["z"]) == pytest.approx(true_poses()[8, 2, 3], abs=1e-6)


def test_a_map_gives_its_own_poses_and_needs_its_recording(recording: Path, tmp_path: Path) -> None:
    moved = with_map(recording, tmp_path / "map")
    export("tum", moved, tmp_path / "out")
    T = read_tum(tmp_path / "out" / "keyframes.tum")[1]
    assert T[:, :3, 3] == pytest.approx(1.1 * true_poses()[::EVERY, :3, 3], abs=1e-6)
    assert len(read_tum(tmp_path / "out" / "primary.tum")[0]) == FRAMES
