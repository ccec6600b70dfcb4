from dataclasses import replace

import numpy as np
import pytest

from bench.scripted import ScriptedBackbone
from calm_edge.config import Config, merge
from calm_edge.estimator.localizer import Localizer
from calm_edge.geometry import se3
from tests.drives import T_P_A, circle, scene, windows

SPACING_M = float(np.linalg.norm(T_P_A[:3, 3]))
METRES = merge(Config(), {"scale": {"spacing_m": SPACING_M}, "correction": {"apply": "never"}})


def with_loop_to(keyframe, window):
    return replace(window, loop_keyframe=keyframe)


def test_the_loop_view_closes_a_loop_and_does_not_affect_the_scale():
    T = circle(150)
    cut = windows(150)
    localizer = Localizer(METRES, ScriptedBackbone(scene(T)))
    for window in cut[:-1]:
        localizer.process(window)
    update = localizer.process(with_loop_to(cut[0].primary[0], cut[-1]))
    assert len(update.submap.T_s_c) == 31 - 15 * 2 + 2 * len(cut[-1].primary)
    assert update.submap.scale == pytest.approx(1.0, abs=1e-9)
    assert update.loop.match_id == 0
    expected = se3.inverse(T[0]) @ T[update.loop.query_id]
    assert np.allclose(update.loop.T_match_query, expected, atol=1e-9)
    assert update.trajectory.epoch == 1 and len(update.trajectory.t_ns) == 150


def test_a_loop_to_a_place_without_a_pose_is_no_loop():
    T = circle(60)
    cut = windows(60)
    localizer = Localizer(METRES, ScriptedBackbone(scene(T)))
    localizer.process(cut[0])
    update = localizer.process(with_loop_to(cut[-1].primary[-1], cut[1]))
    assert update.loop is None and update.loop_keyframe is None
    assert len(update.submap.T_s_c) == len(update.prediction.T_s_c) == 30


def test_without_loops_a_recorded_loop_keyframe_is_left_out():
    class Counting(ScriptedBackbone):
        views = ()

        def infer(self, images, hints):
            self.views += ((len(images), len(hints.t_ns)),)
            return super().infer(images, hints)

    T, cut = circle(60), windows(60)
    backbone = Counting(scene(T))
    localizer = Localizer(merge(METRES, {"loops": {"enabled": False}}), backbone)
    localizer.process(cut[0])
    update = localizer.process(with_loop_to(cut[0].primary[0], cut[1]))
    assert backbone.views == ((30, 30), (30, 30))
    assert update.loop is None and update.loop_keyframe is None
    assert update.trajectory.epoch == 0 and len(update.submap.T_s_c) == 30
