"""Inputs of each method and the results kept."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench import drives, pixels, steps
from bench.__main__ import main
from bench.rivals.environment import RivalMissing, RivalRun
from bench.steps import Cost
from calm_edge.evaluation import EvaluationError
from calm_edge.evaluation.estimate import Estimate
from tests.bench.rivals.test_calibration import RIG, N, write
from tests.evaluation.worlds import curve


@pytest.fixture
def case(tmp_path: Path) -> pixels.Case:
    loose, in_step = write(tmp_path / "loose"), write(tmp_path / "in_step")
    return pixels.Case("k", drives.there(loose), drives.there(in_step), 0.6)


def test_ours_gets_the_spacing_and_nothing_else(
    case: pixels.Case, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[Any] = []

    def record(sequence: Path, out: Path, options: tuple[str, ...]) -> Cost:
        said.append((sequence, options))
        return Cost(2.0, 3.0)

    figures = dict.fromkeys(pixels._KEPT, 1.0) | {"stage_ms": {}}
    monkeypatch.setattr(steps, "record", record)
    monkeypatch.setattr(steps, "figures", lambda *_: figures)
    result = pixels.measure(case, "ours", tmp_path / "out")
    assert said == [(tmp_path / "loose", ("--spacing-m", "0.6"))]
    assert result["cpu_s"] == 3.0 and result["ate_se3_m"] == 1.0 and "stage_ms" not in result


CLAIMED = {
    "orbslam3": ("in_step", 1.0, 0.0, 0),
    "orbslam3_focal": ("in_step", 1.02, 0.0, 0),
    "orbslam3_yaw": ("in_step", 1.0, 0.5, 0),
    "orbslam3_frame": ("in_step", 1.0, 0.0, 1),
    "orbslam3_loose": ("loose", 1.0, 0.0, 0),
}


@pytest.mark.parametrize("method", CLAIMED)
def test_orbslam3_gets_the_truth_but_for_one_parameter(
    method: str, case: pixels.Case, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drive, focal, yaw, shift = CLAIMED[method]
    T = curve(N)

    def run(folder: Path, given: Any, _work: Path, by: int) -> RivalRun:
        assert folder.name == drive and by == shift
        np.testing.assert_allclose(given.cameras[0].fx, 50 * focal)
        cosine = (np.trace(RIG[:3, :3].T @ given.T_p_a[:3, :3]) - 1) / 2
        assert np.degrees(np.arccos(np.clip(cosine, -1, 1))) == pytest.approx(yaw, abs=1e-3)
        t_ns = np.arange(N, dtype=np.int64)[:30] * 10**8 + 10**9
        return RivalRun(t_ns, T[:30], N, 4.0, 5.0)

    monkeypatch.setattr(pixels.orbslam3, "run", run)
    result = pixels.measure(case, method, tmp_path / "out")
    assert result["placed"] == 0.5 and result["cpu_s"] == 4.0
    assert result["ate_se3_m"] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("alignment", ["sim3", "sl4"])
def test_chaining_takes_the_submaps_that_ours_made(
    alignment: str, case: pixels.Case, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    assert "--method ours first" in pixels.measure(case, alignment, out)["skipped"]
    recording = out / "k" / "ours" / "recording"
    recording.mkdir(parents=True)
    t_ns = np.arange(N, dtype=np.int64) * 10**8 + 10**9

    def chained(path: Path, by: str) -> Estimate:
        assert path == recording and by == alignment
        T = curve(N)
        T[:, :3, 3] *= 1.1
        return Estimate("r", t_ns, T)

    monkeypatch.setattr(pixels, "chained", chained)
    figures = pixels.measure(case, alignment, out)
    assert figures["ate_sim3_m"] == pytest.approx(0.0, abs=1e-6) and figures["ate_se3_m"] > 0.5


def test_a_drive_in_step_has_no_loose_row(case: pixels.Case, tmp_path: Path) -> None:
    same = replace(case, loose=case.in_step)
    assert "no clock faults" in pixels.measure(same, "orbslam3_loose", tmp_path)["skipped"]


def test_absence_is_skipped_and_failure_is_kept(
    case: pixels.Case, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gone = replace(case, loose=drives.there(tmp_path / "gone"))
    assert "is not here" in pixels.measure(gone, "ours", tmp_path)["skipped"]

    def fail(error: Exception) -> Any:
        def run(*_: Any) -> RivalRun:
            raise error

        return run

    monkeypatch.setattr(pixels.colmap, "run", fail(RivalMissing("no wheel")))
    assert pixels.measure(case, "colmap", tmp_path) == {"skipped": "no wheel"}
    monkeypatch.setattr(pixels.colmap, "run", fail(EvaluationError("crashed")))
    assert pixels.measure(case, "colmap", tmp_path) == {"failed": "crashed"}


def test_a_rival_that_placed_nothing_has_no_error(case: pixels.Case, tmp_path: Path) -> None:
    run = RivalRun(np.zeros(0, np.int64), np.zeros((0, 4, 4)), 60, 1.0, 1.0)
    figures = pixels.judged(run, tmp_path / "loose")
    assert figures["placed"] == 0.0 and "ate_se3_m" not in figures


def test_a_run_adds_to_what_is_known(
    case: pixels.Case,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(pixels, "CASES", (case,))
    monkeypatch.setattr(pixels, "EVERY", {"k": case})
    errors = {"ours": 1.0, "orbslam3": 0.5}

    def method(name: str) -> pixels.Method:
        def measured(_case: pixels.Case, _out: Path) -> dict[str, Any]:
            return {
                "ate_se3_m": errors[name],
                "path_m": 50.0,
                "placed": 1.0,
                "coverage_percent": 100.0,
                "focal_sigma_percent": [1.0, 1.0],
            }

        return measured

    monkeypatch.setattr(pixels, "METHODS", {name: method(name) for name in errors})
    out = ["--out", str(tmp_path / "out")]
    assert main(["pixels", *out, "--method", "ours"]) == 0
    assert main(["pixels", *out, "--method", "orbslam3"]) == 1
    kept = json.loads((tmp_path / "out" / "pixels.json").read_text())
    assert kept["drives"]["k"]["ours"]["ate_se3_m"] == 1.0
    assert kept["targets"][0]["measured"] == 2.0 and kept["targets"][0]["passed"] is False
    errors["ours"] = 0.4
    assert main(["pixels", *out, "--show"]) == 1
    assert main(["pixels", *out, "--method", "ours"]) == 0
    assert "0.8" in capsys.readouterr().out
    rows = pixels.table(pixels.read_results(tmp_path / "out" / "pixels.json"))
    assert [row[1] for row in rows] == ["ours", "orbslam3"]
    assert rows[0][3] == pytest.approx(0.8)
