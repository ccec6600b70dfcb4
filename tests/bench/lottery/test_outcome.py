"""Outcomes of lottery drives: kept by the state of the code, and failures are outcomes too."""

import numpy as np
import pytest

from bench import steps
from bench.lottery import outcome as outcomes
from bench.lottery.draw import Drawn
from calm_edge.evaluation import EvaluationError
from calm_edge.trajectories import write_kitti
from tests.evaluation.worlds import curve


@pytest.fixture
def drawn(tmp_path, monkeypatch):
    monkeypatch.setattr(outcomes, "FOLDER", tmp_path / "kept")
    folder = tmp_path / "drive"
    folder.mkdir()
    write_kitti(folder / "poses0.txt", curve(20))
    (folder / "times0.txt").write_text("\n".join(f"{0.1 * k:.1f}" for k in range(20)))
    return Drawn("lottery_plain_0_00", 0.5, lambda _: folder)


@pytest.fixture
def checkout(tmp_path):
    code = tmp_path / "code" / "calm_edge"
    code.mkdir(parents=True)
    (code / "a.py").write_text("a = 1\n")
    return tmp_path / "code"


def test_a_drive_without_a_result_is_wholly_garbage_and_says_why(drawn, checkout, monkeypatch):
    def run(*_, **__):
        raise EvaluationError("calm-edge: too dark")

    monkeypatch.setattr(steps, "calm_edge", run)
    found = outcomes.outcome(drawn, checkout)
    assert (found.ate_percent, found.garbage, found.placed) == (None, 1.0, 0.0)
    assert found.failed == "calm-edge: too dark" and found.path_m > 1


def test_an_outcome_is_computed_once_for_each_state_of_the_code(drawn, checkout, monkeypatch):
    runs = []

    def run(*words, **_):
        runs.append(words)
        raise EvaluationError("nothing")

    monkeypatch.setattr(steps, "calm_edge", run)
    first = outcomes.outcome(drawn, checkout)
    assert outcomes.outcome(drawn, checkout) == first and len(runs) == 1
    (checkout / "calm_edge" / "a.py").write_text("a = 2\n")
    outcomes.outcome(drawn, checkout)
    assert len(runs) == 2


def test_a_drive_that_cannot_be_rendered_is_an_error(checkout):
    missing = Drawn("lottery_plain_0_01", 0.5, lambda _: "drive_sim.py is not here")
    with pytest.raises(EvaluationError, match="drive_sim"):
        outcomes.outcome(missing, checkout)


def test_garbage_is_counted_after_one_scale_for_the_drive():
    true = np.full(10, 2.0)
    step = 0.5 * true
    step[3] *= 1.3
    assert outcomes.garbage_share(step, true) == pytest.approx(0.1)
