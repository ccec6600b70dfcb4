"""The paper's settings on a dataset: one row a sequence, the truth only for `eval`."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench import steps
from bench.__main__ import main
from bench.datasets import table
from bench.datasets.command import NAMES
from bench.steps import Cost
from calm_edge.evaluation import EvaluationError
from calm_edge.evaluation.truth import read_truth
from calm_edge.recording.sequence_folder import SequenceFolder
from device.frame import Eye
from tests.bench.datasets import trees


class Steps:
    """Stand-in for the processes that records their arguments."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.recorded: list[tuple[Path, tuple[str, ...]]] = []
        self.mapped: list[Path] = []
        self.judged: list[tuple[Path, Path]] = []
        self.refuse = ""
        monkeypatch.setattr(steps, "record", self._record)
        monkeypatch.setattr(steps, "dense_map", self._map)
        monkeypatch.setattr(steps, "figures", self._figures)

    def _record(self, sequence: Path, _out: Path, options: list[str]) -> Cost:
        SequenceFolder(sequence)
        if self.refuse and self.refuse in sequence.parts:
            raise EvaluationError("calm-edge record: exit 1: too dark")
        self.recorded.append((sequence, tuple(options)))
        return Cost(1.0, 2.0)

    def _map(self, _recording: Path, out: Path) -> Cost:
        self.mapped.append(out)
        return Cost(1.0, 2.0)

    def _figures(self, target: Path, truth: Path) -> dict[str, Any]:
        self.judged.append((target, truth))
        ate = 1.0 + len(self.judged)
        return {
            "ate_sim3_m": ate,
            "path_m": 100.0,
            "focal_error_px": [-2.0, 4.0],
            "scale_std": None,
        }


@pytest.fixture
def ran(monkeypatch: pytest.MonkeyPatch) -> Steps:
    return Steps(monkeypatch)


def test_the_command_names_every_dataset() -> None:
    assert tuple(table.DATASETS) == NAMES


def test_rows_and_their_average(
    ran: Steps, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = trees.kitti_odometry(trees.kitti_odometry(tmp_path / "d"), "03")
    out = str(tmp_path / "out")
    assert main(["datasets", "kitti-odom", str(root), "--out", out]) == 0
    heading, first, second, mean = capsys.readouterr().out.splitlines()
    assert heading.split()[:2] == ["sequence", "frames"]
    assert first.split()[0] == "00" and " 2 " in first
    assert second.split()[0] == "03" and " 3 " in second
    assert mean.split()[0] == "average" and "2.5" in mean
    # calibration-free and loops as configured
    assert [options for _, options in ran.recorded] == [(), ()]
    assert not ran.mapped


def test_kitti_360_is_run_as_in_the_paper(
    ran: Steps, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = trees.kitti_360(tmp_path / "d")
    command = ["datasets", "kitti-360", str(root), "--out", str(tmp_path / "out")]
    command += ["--async", "--frames", "8", "--metric", "--set", "frontend.n_max=9"]
    assert main(command) == 0
    ((sequence, options),) = ran.recorded
    assert options[:4] == ("--set", "loops.enabled=false", "--set", "frontend.n_max=9")
    assert options[4] == "--spacing-m" and float(options[5]) == pytest.approx(trees.SPACING_M)
    folder = SequenceFolder(sequence)
    assert (folder.count(Eye.PRIMARY), folder.count(Eye.ASSISTANT)) == (4, 4)
    late = folder.t_ns(Eye.PRIMARY) - folder.t_ns(Eye.ASSISTANT)
    np.testing.assert_array_equal(late, 50_000_000 - 4000)
    assert "interpolated" in capsys.readouterr().err


def test_argoverse_is_mapped_on_request_and_judged_by_its_cloud(
    ran: Steps, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = trees.argoverse(tmp_path / "d")
    command = ["datasets", "argoverse", str(root), "--out", str(tmp_path / "out"), "--map"]
    assert main([*command, "--sequence", "0ef", "--json"]) == 0
    captured = capsys.readouterr()
    said = json.loads(captured.out)
    assert said["sequences"]["0ef"]["ate_sim3_m"] == 2.0
    assert said["average"]["focal_error_px"] == 3.0 and said["average"]["scale_std"] is None
    ((target, truth),) = ran.judged
    assert ran.mapped == [target] and read_truth(truth).cloud is not None


def test_a_sequence_that_fails_is_a_row_and_an_exit_code(
    ran: Steps, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = trees.kitti_odometry(trees.kitti_odometry(tmp_path / "d"), "03")
    ran.refuse = "00"
    assert main(["datasets", "kitti-odom", str(root), "--out", str(tmp_path / "out")]) == 1
    rows = capsys.readouterr().out.splitlines()
    assert rows[1].startswith("00") and rows[1].endswith("too dark")
    assert rows[2].split()[0] == "03" and " 2 " in rows[3]


@pytest.mark.parametrize("dataset", NAMES)
def test_a_wrong_root_is_one_line_that_names_what_is_missing(
    dataset: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["datasets", dataset, str(tmp_path), "--out", str(tmp_path / "out")]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"bench: {tmp_path}")
    assert any(word in line for word in ("sequences", "data_2d_raw", "vehicle_calibration_info"))


def test_one_frame_is_no_drive(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["datasets", "kitti-odom", str(tmp_path), "--frames", "1"]) == 1
    assert "--frames 1" in capsys.readouterr().err


def test_a_real_recording_of_a_dataset(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The written folder passes through the real `record` and `eval`."""
    root = trees.kitti_odometry(tmp_path / "d")
    command = ["datasets", "kitti-odom", str(root), "--out", str(tmp_path / "out"), "--json"]
    assert main(command) == 0
    said = json.loads(capsys.readouterr().out)["sequences"]["00"]
    assert said["frames"] == trees.N
    # twelve evenly grey pictures: nothing to track, nothing claimed
    assert said["ate_sim3_m"] is None and said["focal_error_px"] in (None, [None, None])
