import dataclasses

import numpy as np
import pytest

from bench.kilometres import drives
from bench.kilometres.loops import ScriptedLoops, true_loops
from bench.kilometres.streams import Streams
from bench.scripted import ScriptedBackbone, ScriptedErrors
from calm_edge.config import Config
from calm_edge.types import Hints
from tests.bench.scripted.street_drive import street
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


def remembering(drive, **dials):
    """A finder that remembers all windows, as at the end of the drive."""
    finder = ScriptedLoops(drive, **dials)
    for window in drive.windows:
        finder.remember(window)
    return finder


def found(finder, drive):
    pairs = [(w, finder.find(w, [], None)) for w in drive.windows]
    return [(w, candidate) for w, candidate in pairs if candidate is not None]


def test_candidates_are_found_at_the_rate_of_the_dial(drive):
    everything = remembering(drive, detection=1.0)
    possible = found(everything, drive)
    assert len(possible) >= 10
    for w, candidate in possible:
        query_id = w.primary[candidate.query_view].id
        assert everything.is_true(query_id, candidate.keyframe.id)
        T = np.linalg.inv(drive.T_w_p[query_id]) @ drive.T_w_p[candidate.keyframe.id]
        assert candidate.agrees(T, np.linalg.norm(drive.scene.T_p_a[:3, 3]))
    some = sum(len(found(remembering(drive, detection=0.6, seed=s), drive)) for s in range(8))
    assert some / (8 * len(possible)) == pytest.approx(0.6, abs=0.1)


def test_only_what_has_a_pose_is_found(drive):
    assert not found(ScriptedLoops(drive, detection=1.0), drive)


def test_false_candidates_come_from_elsewhere(drive):
    finder = remembering(drive, detection=0.0, false_share=1.0, seed=2)
    false = found(finder, drive)
    assert len(false) > 3
    for w, candidate in false:
        query_id = w.primary[candidate.query_view].id
        assert not finder.is_true(query_id, candidate.keyframe.id)
    assert not found(remembering(drive, detection=0.0), drive)


@pytest.mark.parametrize("aliased", [True, False])
def test_an_aliased_place_fools_the_look_up_as_it_fools_the_model(drive, aliased):
    finder = remembering(drive, detection=0.0, false_share=1.0, aliased=aliased, seed=2)
    backbone = ScriptedBackbone(drive.scene, ScriptedErrors())
    agreed = []
    for window, candidate in found(finder, drive)[:6]:
        keyframes = (*window.keyframes(), candidate.keyframe)
        hints = Hints(
            eyes=np.array([int(k.frame.eye) for k in keyframes]),
            t_ns=np.array([k.frame.t_ns for k in keyframes]),
            loop=True,
        )
        T = backbone.infer([], hints).T_s_c
        spacing = np.linalg.norm(drive.scene.T_p_a[:3, 3])
        agreed.append(candidate.agrees(np.linalg.inv(T[candidate.query_view]) @ T[-1], spacing))
    assert len(agreed) > 3 and np.mean(agreed) == (1.0 if aliased else pytest.approx(0.0, abs=0.4))
