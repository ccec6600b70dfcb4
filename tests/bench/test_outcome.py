"""Outcomes of drives: kept by the state of the code, and failures are outcomes too."""

import json
import math

import numpy as np
import pytest

from bench import outcome as outcomes
from bench import steps
from bench.outcome import Outcome, Trial
from bench.relative_poses import Stretches
from calm_edge.evaluation import EvaluationError
from calm_edge.geometry import se3
from calm_edge.trajectories import write_kitti
from tests.evaluation.worlds import curve


@pytest.fixture
def drawn(tmp_path, monkeypatch):
    monkeypatch.setattr(outcomes, "FOLDER", tmp_path / "kept")
    folder = tmp_path / "drive"
    folder.mkdir()
    write_kitti(folder / "poses0.txt", curve(20))
    (folder / "times0.txt").write_text("\n".join(f"{0.1 * k:.1f}" for k in range(20)))
    return Trial("lottery_plain_0_00", lambda _: folder, ("--spacing-m", "0.5"))


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
    assert found.observed == (False, False)


def test_an_outcome_is_computed_once_for_each_state_of_the_code(drawn, checkout, monkeypatch):
    runs = []

    def run(*words, **_):
        runs.append(words)
        raise EvaluationError("nothing")

    monkeypatch.setattr(steps, "calm_edge", run)
    first = outcomes.outcome(drawn, checkout)
    assert outcomes.outcome(drawn, checkout) == first and len(runs) == 1
    assert runs[0][-2:] == ("--spacing-m", "0.5")
    (checkout / "calm_edge" / "a.py").write_text("a = 2\n")
    outcomes.outcome(drawn, checkout)
    assert len(runs) == 2


def test_a_complete_recording_is_measured_again_without_being_made(drawn, checkout, monkeypatch):
    said = []

    def run(*words, **_):
        said.append(words[0])
        if words[0] == "eval":
            raise EvaluationError("nothing")
        folder = outcomes.recording_of(drawn, checkout)
        folder.mkdir(parents=True)
        (folder / "record_trajectory.tum").write_text("")
        return "", steps.Cost(0.0, 0.0)

    monkeypatch.setattr(steps, "calm_edge", run)
    for key in ("a", "b", "b"):
        monkeypatch.setattr(outcomes, "measure_key", lambda key=key: key)
        outcomes.outcome(drawn, checkout)
    assert said == ["record", "eval", "eval"]


def test_a_recording_of_mixed_code_is_not_kept(drawn, checkout, monkeypatch):
    def run(*_, **__):
        (checkout / "calm_edge" / "a.py").write_text("a = 3\n")
        raise EvaluationError("nothing")

    monkeypatch.setattr(steps, "calm_edge", run)
    work = outcomes.recording_of(drawn, checkout).parent
    with pytest.raises(EvaluationError, match="its code changed"):
        outcomes.outcome(drawn, checkout)
    assert not work.exists() and not list(work.parent.glob("*.json"))


def test_a_drive_that_cannot_be_rendered_is_an_error(drawn, checkout):
    missing = Trial("lottery_plain_0_01", lambda _: "drive_sim.py is not here", ())
    with pytest.raises(EvaluationError, match="drive_sim"):
        outcomes.outcome(missing, checkout)


def test_an_outcome_survives_its_file():
    stretches = Stretches(np.ones((2, 6)), np.full((2, 6), np.nan), np.array([9.0, 11.0]))
    found = Outcome(
        "d", 1.0, 2.0, 0.1, 0.2, 0.99, math.inf, 1.0, 0.0, (0.1, 0.2), (0.3, math.inf),
        {"1 s": stretches}, {"100 m": Stretches.none()},
    )  # fmt: skip
    again = Outcome.of_json(json.loads(json.dumps(found.to_json())))
    assert again.to_json()["final"]["100 m"] == {"error": [], "sigma": [], "length_m": []}
    np.testing.assert_array_equal(again.live["1 s"].sigma, stretches.sigma)
    assert (again.focal_sigma, again.scale_sigma) == ((0.3, math.inf), math.inf)
    assert again.scale_error == pytest.approx(-math.log(0.99))


def test_turns_to_both_sides_do_not_cancel():
    heading = np.radians([0, 10, 20, 10, 0, 0])
    T = np.tile(np.eye(4), (6, 1, 1))
    T[:, :3, :3] = se3.so3_exp(np.stack([0 * heading, heading, 0 * heading], 1))
    assert outcomes.heading_range_deg(T) == pytest.approx(20)
