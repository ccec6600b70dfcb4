import dataclasses

import numpy as np
import pytest

from calm_edge.config import Config
from calm_edge.evaluation.kilometres import drives
from calm_edge.evaluation.kilometres.loops import ScriptedLoops, true_loops, with_loop
from calm_edge.evaluation.kilometres.streams import Streams
from tests.backbones.scripted.street_drive import street
from tests.drives import PERIOD_NS, START_NS, circle


@pytest.fixture(scope="module")
def drive():
    """Twice around a circle of 60 m radius."""
    T = np.concatenate([circle(300, 60.0)] * 2)
    scene = dataclasses.replace(
        street(), T_w_p=T, t_ns=START_NS + PERIOD_NS * np.arange(len(T)), street=None
    )
    return drives.cut("circle", scene, Config(), Streams(), 0)


def test_true_loops_are_near_look_alike_and_lie_apart_in_the_drive(drive):
    loops = true_loops(drive.T_w_p, 60)
    assert len(loops) > 100
    T = np.linalg.inv(drive.T_w_p[loops[:, 1]]) @ drive.T_w_p[loops[:, 0]]
    assert np.linalg.norm(T[:, :3, 3], axis=1).max() < 4.0
    assert (loops[:, 0] - loops[:, 1]).min() >= 60
    assert np.all(T[:, 2, 2] > 0.7)


def test_a_place_passed_the_other_way_is_no_loop(drive):
    away = drive.T_w_p[100:200].copy()
    away[:, :3, :3] = away[:, :3, :3] @ np.diag([-1.0, 1.0, -1.0])
    back = np.concatenate([drive.T_w_p[:200], away])
    assert not np.any(true_loops(back, 60)[:, 0] >= 200)


def test_candidates_are_found_at_the_rate_of_the_dial(drive):
    everything = ScriptedLoops(drive, detection=1.0)
    possible = [w for w in drive.windows if everything.find(w)]
    assert len(possible) >= 10
    for w in possible:
        query, match = everything.find(w)
        assert query in {k.id for k in w.primary[w.n_overlap :]} and match.id < query
        assert everything.is_true(query, match.id)
        assert with_loop(w, everything).loop_keyframe == match
    found = [
        ScriptedLoops(drive, detection=0.6, seed=s).find(w) for s in range(20) for w in possible
    ]
    assert np.mean([f is not None for f in found]) == pytest.approx(0.6, abs=0.1)


def test_false_candidates_come_from_elsewhere(drive):
    finder = ScriptedLoops(drive, detection=0.0, false_share=1.0, seed=2)
    false = [found for w in drive.windows if (found := finder.find(w))]
    assert len(false) > 3
    for query, match in false:
        assert not finder.is_true(query, match.id)
    assert not any(ScriptedLoops(drive, detection=0.0).find(w) for w in drive.windows)
