import numpy as np
import pytest

from bench.scripted import ScriptedBackbone, ScriptedErrors, epipolar
from calm_edge.backbones.base import BackboneError
from calm_edge.geometry import se3
from tests.bench.scripted.street_drive import batch, street, truth
from tests.drives import PERIOD_NS

WRONG = 0.08


def infer(scene, hints, **dials):
    return ScriptedBackbone(scene, ScriptedErrors(coupled=True, **dials)).infer([], hints)


@pytest.mark.parametrize("turn", [0.0, 0.03])
@pytest.mark.parametrize("late_ns", [0, 40_000_000])
def test_with_the_right_focal_the_poses_are_the_truth(turn, late_ns):
    scene, hints = street(turn=turn), batch(late_ns=late_ns)
    prediction = infer(scene, hints)
    assert np.abs(prediction.T_s_c - truth(scene, hints)).max() < 1e-5
    assert prediction.focal_log_sigma is None and prediction.kit is None


def pair_costs(scene, hints, T, cameras):
    """Mean squared Sampson distance of exact matches between consecutive primary views."""
    exact = ScriptedBackbone(scene).infer([], hints)
    marks, out = exact.landmarks, []
    for a in range(9):
        of = [
            dict(zip(marks.index[marks.view == v], marks.uv[marks.view == v], strict=True))
            for v in (a, a + 1)
        ]
        both = sorted(set(of[0]) & set(of[1]))
        x_a, x_b = (
            cameras[a].back_project(np.array([o[i] for i in both], float), np.ones(len(both)))[None]
            for o in of
        )
        f = np.array([[cameras[a].fx, cameras[a].fy]])
        E = epipolar.essential(se3.inverse(T[a + 1]) @ T[a])[None]
        out.append(float((epipolar.sampson(E, x_a, x_b, f, f) ** 2).mean()))
    return np.array(out)


@pytest.mark.parametrize("turn", [0.0, 0.03])
def test_a_wrong_focal_bends_the_poses_to_fit_the_matches_better_than_the_truth(turn):
    scene, hints = street(turn=turn), batch()
    prediction = infer(scene, hints, focal_log_error=(WRONG, WRONG))
    ours = pair_costs(scene, hints, prediction.T_s_c, prediction.cameras)
    true = pair_costs(scene, hints, truth(scene, hints), prediction.cameras)
    assert ours.mean() < 0.7 * true.mean()
    assert np.mean(ours <= true * (1 + 1e-6)) > 0.8


def test_on_a_straight_road_spacing_shrinks_with_the_focal_and_forward_motion_stays():
    scene, hints = street(), batch()
    for wrong in (-WRONG, WRONG):
        T = infer(scene, hints, focal_log_error=(wrong, wrong)).T_s_c
        steps = np.linalg.norm(np.diff(T[:10, :3, 3], axis=0), axis=1)
        true = truth(scene, hints)
        true_steps = np.linalg.norm(np.diff(true[:10, :3, 3], axis=0), axis=1)
        assert np.allclose(steps, true_steps, rtol=0.02)
        spacing = np.linalg.norm(T[10:, :3, 3] - T[:10, :3, 3], axis=1).mean()
        true_spacing = np.linalg.norm(true[10:, :3, 3] - true[:10, :3, 3], axis=1).mean()
        assert spacing / true_spacing == pytest.approx(np.exp(-wrong), abs=0.015)


def test_a_wrong_focal_turns_too_little_or_too_much():
    scene, hints = street(turn=0.03), batch()
    turned = []
    for wrong in (-WRONG, 0.0, WRONG):
        T = infer(scene, hints, focal_log_error=(wrong, wrong)).T_s_c
        turned.append(np.linalg.norm(se3.so3_log(T[9, :3, :3])))
    assert turned[0] > 1.03 * turned[1] > 1.03**2 * turned[2]


def test_scale_moves_every_length_alike():
    scene, hints = street(), batch()
    a = infer(scene, hints, focal_log_error=(WRONG, WRONG))
    b = infer(scene, hints, focal_log_error=(WRONG, WRONG), scale_log_sigma=1.0)
    ratio = np.linalg.norm(b.T_s_c[1:, :3, 3], axis=1) / np.linalg.norm(a.T_s_c[1:, :3, 3], axis=1)
    assert np.ptp(ratio) < 1e-9 and abs(ratio[0] - 1) > 0.01
    assert np.allclose(b.landmarks.points_s, a.landmarks.points_s * ratio[0])


def test_frames_without_motion_are_refused():
    scene, hints = street(), batch()
    hints.t_ns[1] = hints.t_ns[0] + PERIOD_NS // 1000
    with pytest.raises(BackboneError, match="have the same position"):
        infer(scene, hints)


def test_one_primary_frame_is_refused():
    with pytest.raises(BackboneError, match="at least 2 primary frames"):
        infer(street(), batch(n=1))
