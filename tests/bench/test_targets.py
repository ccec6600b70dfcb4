"""Rows are run, evaluated, kept, and reported as met or missed."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from bench import drives, steps, targets
from bench.__main__ import main
from bench.tables import Check, kept
from calm_edge.evaluation import EvaluationError
from calm_edge.evaluation.estimate import from_updates
from calm_edge.evaluation.results import compare
from calm_edge.evaluation.truth import read_truth
from calm_edge.recording import SequenceError
from calm_edge.recording.sequence_folder import SequenceFolder
from calm_edge.trajectories import write_kitti
from tests.evaluation.worlds import curve, stamps, update


@pytest.mark.parametrize(
    ("metric", "value", "passes"),
    [
        (targets.Metric("k", "", most=1.0), 0.9, True),
        (targets.Metric("k", "", most=1.0), 1.1, False),
        (targets.Metric("k", "", most=1.0), None, False),
        (targets.FOCAL, [4.0, -4.9], True),
        (targets.FOCAL, [4.0, -5.1], False),
        (targets.FOCAL, [4.0, None], False),
        (targets.FOCAL, None, False),
        (targets.Metric("k", "", least=5.0), [6.0, None], True),
        (targets.Metric("k", "", least=5.0), [6.0, 4.0], False),
        (targets.Metric("k", "", least=5.0), None, False),
        (targets.HONEST, [2.9, None], True),
        (targets.HONEST, [3.1, None], False),
        (targets.HONEST, [None, None], True),
    ],
)
def test_judging(metric: targets.Metric, value: object, passes: bool) -> None:
    assert targets.judge(metric, {metric.key: value}) == (value, passes)


def test_a_missing_key_is_not_a_pass() -> None:
    with pytest.raises(targets.TargetError, match="ate_percent"):
        targets.judge(targets.Metric("ate_percent", "", most=1.0), {})


def test_honesty_is_the_error_in_its_own_sigmas() -> None:
    result = {"focal_error_percent": [-2.0, None], "focal_sigma_percent": [0.5, 9.0]}
    assert targets.with_honesty(result)["focal_error_in_sigma"] == [4.0, None]


def test_every_requirement_is_a_key_that_eval_prints(tmp_path: Path) -> None:
    write_kitti(tmp_path / "poses0.txt", curve(20))
    estimate = from_updates("r", [update(curve(20), stamps(20))])
    result = targets.with_honesty(compare(estimate, read_truth(tmp_path)))
    required = {metric.key for row in targets.ROWS for metric in row.metrics}
    assert required <= set(result)
    assert len({row.name for row in targets.ROWS}) == len(targets.ROWS)


def _drive(folder: Path, n: int = 4) -> Path:
    for eye in range(2):
        (folder / f"cam{eye}").mkdir(parents=True)
        for i in range(n):
            (folder / f"cam{eye}" / f"{i:06d}.jpg").write_bytes(b"%d %d" % (eye, i))
        (folder / f"times{eye}.txt").write_text("".join(f"{i / 10}\n" for i in range(n)))
    write_kitti(folder / "poses0.txt", curve(n))
    (folder / "calib.txt").write_text("1 1 0 0 2 2\n1 1 0 0 2 2\n")
    return folder


def test_a_shifted_drive_keeps_true_stamps(tmp_path: Path) -> None:
    folder = drives.shifted_by_one(_drive(tmp_path / "d"), tmp_path / "out")
    assert (folder / "cam0" / "000000.jpg").read_bytes() == b"0 0"
    assert (folder / "cam1" / "000000.jpg").read_bytes() == b"1 1"
    assert (folder / "times1.txt").read_text().split() == ["0.1", "0.2", "0.3"]
    assert len(list((folder / "cam0").iterdir())) == len(list((folder / "cam1").iterdir())) == 3
    truth = read_truth(folder)
    assert len(truth.t_ns) == 3 and truth.cameras is not None
    with pytest.raises(SequenceError, match=r"000000\.jpg"):
        SequenceFolder(folder)  # these are links to what are no pictures


def _steps(monkeypatch: pytest.MonkeyPatch, ate: float = 0.0) -> list[tuple[str, ...]]:
    said: list[tuple[str, ...]] = []

    def calm_edge(*arguments: str, **_: Any) -> tuple[str, steps.Cost]:
        said.append(arguments)
        text = json.dumps({"ate_percent": ate}) if arguments[0] == "eval" else ""
        return text, steps.Cost(2.0, 1.0)

    monkeypatch.setattr(steps, "calm_edge", calm_edge)
    return said


def _row(tmp_path: Path) -> targets.Row:
    return targets.Row(
        "r",
        drives.there(_drive(tmp_path / "d")),
        ("--spacing-m", "0.5"),
        (targets.Metric("ate_percent", "<= 1 %", most=1.0),),
    )


@pytest.mark.parametrize(("ate", "passes"), [(0.5, True), (1.5, False)])
def test_a_row_is_recorded_mapped_and_judged(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, ate: float, passes: bool
) -> None:
    said = _steps(monkeypatch, ate)
    measured = targets.run_row(_row(tmp_path), tmp_path / "out")
    assert [a[0] for a in said] == ["record", "map", "eval"]
    assert said[0][-2:] == ("--spacing-m", "0.5") and "lockstep" in said[0]
    # truth is for eval only
    assert [("--truth" in a) for a in said] == [False, False, True]
    assert measured.checks == (Check("ate_percent", "<= 1 %", ate, passes),)
    assert measured.seconds == {"record": 2.0, "map": 2.0}


@pytest.mark.parametrize("same", [True, False])
def test_determinism_compares_bytes(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, same: bool
) -> None:
    T = [curve(5), curve(5)]
    T[1][2, 0, 3] += 0.0 if same else 1e-6
    runs = iter(T)
    _steps(monkeypatch)
    monkeypatch.setattr(
        targets, "read_estimate", lambda _: from_updates("r", [update(next(runs), stamps(5))])
    )
    row = targets.Row("r", drives.there(_drive(tmp_path / "d")), twice=True)
    (check,) = targets.run_row(row, tmp_path / "out").checks
    assert check.passed is same


def test_absent_data_is_skipped_and_said(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(targets, "ROWS", (targets.Row("gone", drives.there(tmp_path / "gone")),))
    assert main(["targets", "--out", str(tmp_path / "out")]) == 0
    assert "skipped" in capsys.readouterr().out
    (table,) = kept(tmp_path / "out")
    assert table.name == "10_targets" and not table.checks
    assert "gone: skipped" in table.notes[-1] and "is not here" in table.notes[-1]
    # the page's own file is written by `tables` alone
    assert not (tmp_path / "out" / "report.json").exists()


def test_a_failing_step_breaks_the_run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def fails(*_: str, **__: Any) -> tuple[str, steps.Cost]:
        raise EvaluationError("calm-edge record: exit 1: no")

    monkeypatch.setattr(steps, "calm_edge", fails)
    monkeypatch.setattr(targets, "ROWS", (_row(tmp_path),))
    assert main(["targets", "--out", str(tmp_path / "out")]) == 1
    (table,) = kept(tmp_path / "out")
    assert table.checks == (Check("r: run", "works", "calm-edge record: exit 1: no", False),)


def test_a_run_of_some_rows_adds_to_the_table_and_answers_for_these(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    row = _row(tmp_path)
    monkeypatch.setattr(targets, "ROWS", (row, replace(row, name="s")))
    out = tmp_path / "out"
    for name, ate, code in (("s", 1.5, 1), ("r", 0.5, 0), ("s", 0.7, 0)):
        _steps(monkeypatch, ate)
        assert main(["targets", "--out", str(out), "--only", name]) == code
    (table,) = kept(out)
    assert [r[0] for r in table.rows] == ["r", "s"]
    assert [c.measured for c in table.checks] == [0.5, 0.7]
