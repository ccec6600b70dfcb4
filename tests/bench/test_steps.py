"""Each step is a command as a user would type it; its failure is the last line it prints."""

import json
from pathlib import Path
from typing import Any

import pytest

from bench import steps
from bench.steps import Cost
from calm_edge.evaluation import EvaluationError


def test_a_failing_command_is_named_with_its_last_line(tmp_path: Path) -> None:
    with pytest.raises(EvaluationError, match=r"calm-edge record: exit 1: .*nowhere"):
        steps.record(tmp_path / "nowhere", tmp_path / "out")


def test_the_cost_is_the_processs_own() -> None:
    said, cost = steps.calm_edge("--help")
    assert "record" in said and cost.cpu_s > 0 and cost.wall_s > 0


def test_only_evaluation_sees_the_truth(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    called: list[tuple[str, ...]] = []

    def calm_edge(*arguments: str, **_: Any) -> tuple[str, Cost]:
        called.append(arguments)
        return json.dumps({"poses": 3}), Cost(1.0, 1.0)

    monkeypatch.setattr(steps, "calm_edge", calm_edge)
    for name in ("rec", "map"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "old").touch()
    steps.record(tmp_path / "s", tmp_path / "rec", ("--spacing-m", "1"))
    steps.dense_map(tmp_path / "rec", tmp_path / "map")
    assert steps.figures(tmp_path / "map", tmp_path / "s") == {"poses": 3}
    assert [c[0] for c in called] == ["record", "map", "eval"]
    assert "lockstep" in called[0] and called[0][-2:] == ("--spacing-m", "1")
    assert ["--truth" in c for c in called] == [False, False, True]
    # what an earlier run left there is gone
    assert not (tmp_path / "rec").exists() and not (tmp_path / "map").exists()
