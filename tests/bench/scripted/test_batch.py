import numpy as np
import pytest

from bench.scripted import DEPTH_STRIDE, ScriptedBackbone, ScriptedErrors
from calm_edge.geometry import se3
from calm_edge.geometry.camera import project_each
from tests.bench.scripted.street_drive import batch, street, truth

SCENE = street(turn=0.01)
WRONG = 0.08


def infer(hints, **dials):
    return ScriptedBackbone(SCENE, ScriptedErrors(coupled=True, **dials)).infer([], hints)


def observed(marks):
    return {
        (int(v), int(i)): uv for v, i, uv in zip(marks.view, marks.index, marks.uv, strict=True)
    }


def reprojected(prediction):
    marks = prediction.landmarks
    T = se3.inverse(prediction.T_s_c)[marks.view]
    p_c = (T[:, :3, :3] @ marks.points_s[marks.index, :, None])[..., 0] + T[:, :3, 3]
    return np.linalg.norm(project_each(prediction.cameras, marks.view, p_c) - marks.uv, axis=1)


def test_landmarks_are_where_they_were_seen():
    prediction = infer(batch())
    marks = prediction.landmarks
    assert np.median(reprojected(prediction)) < 1e-3
    assert set(marks.view.tolist()) == set(range(20))
    assert set(np.unique(marks.index)) == set(range(len(marks.points_s)))
    seen_by_neighbours = np.intersect1d(marks.index[marks.view == 3], marks.index[marks.view == 4])
    assert len(seen_by_neighbours) > 80


def test_landmarks_follow_the_model_where_its_focal_is_wrong():
    prediction = infer(batch(), focal_log_error=(WRONG, WRONG))
    # its points fit its own poses to a few px although both are far from the truth
    assert np.median(reprojected(prediction)) < 1.0
    true = infer(batch()).landmarks
    assert np.abs(true.points_s.std(0)[2] / prediction.landmarks.points_s.std(0)[2] - 1) < 0.2


def test_matches_have_the_noise_and_the_outliers_of_the_dials():
    exact = observed(infer(batch()).landmarks)
    noisy = observed(infer(batch(), match_sigma_px=0.4, outlier_share=0.06).landmarks)
    assert exact.keys() == noisy.keys()
    off = np.array([noisy[key] - exact[key] for key in exact])
    wild = np.linalg.norm(off, axis=1) > 3.0
    assert wild.mean() == pytest.approx(0.06, abs=0.015)
    assert off[~wild].std() == pytest.approx(0.4, rel=0.05)


def test_a_pictures_corners_are_the_same_in_every_batch():
    one, two = infer(batch(20)), infer(batch(25))
    (uv_one,) = (one.landmarks.uv[one.landmarks.view == 7],)
    (uv_two,) = (two.landmarks.uv[two.landmarks.view == 2],)
    common = set(map(tuple, uv_one.tolist())) & set(map(tuple, uv_two.tolist()))
    assert len(common) > 20


def test_equal_hints_are_equal_predictions():
    dials = {"focal_log_sigma": 0.05, "rotation_sigma_rad": 0.001, "match_sigma_px": 0.4}
    one, two, other = (
        infer(batch(), **dials),
        infer(batch(), **dials),
        infer(batch(), **dials, seed=1),
    )
    assert np.array_equal(one.T_s_c, two.T_s_c)
    assert np.array_equal(one.landmarks.uv, two.landmarks.uv)
    assert one.cameras[0].fx != pytest.approx(other.cameras[0].fx)


def depth(hints, **dials):
    backbone = ScriptedBackbone(SCENE, ScriptedErrors(coupled=True, **dials))
    return backbone.densify([], hints, backbone.infer([], hints))


def true_depth(hints, view):
    width, height = SCENE.size.min(0) // DEPTH_STRIDE
    small = np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1).reshape(-1, 2) * 1.0
    eye = hints.eyes[view]
    camera = SCENE.cameras[eye].scaled(width / SCENE.size[eye][0], height / SCENE.size[eye][1])
    T = SCENE.T_w_c(hints.eyes, hints.t_ns)[[view]]
    return SCENE.surface([camera], T, small[None])[0].reshape(height, width)


def test_with_the_right_focal_depth_is_the_surface():
    hints = batch(n=4)
    prediction = depth(hints)
    assert prediction.depth.shape == prediction.confidence.shape == (8, 25, 80)
    for view in (0, 2, 5):
        z, true = prediction.depth[view], true_depth(hints, view)
        known = z > 0
        assert known.mean() > 0.5 and not known[np.isinf(true)].any()
        assert np.allclose(z[known], true[known], rtol=1e-3)


def test_confidence_is_less_for_what_is_far():
    prediction = depth(batch(n=4))
    z, confidence = prediction.depth[1], prediction.confidence[1]
    assert confidence.min() >= 0 and confidence.max() <= 1 and not confidence[z == 0].any()
    assert confidence[z > 40].mean() < confidence[(z > 0) & (z < 15)].mean()


def test_a_wrong_focal_leaves_what_lies_ahead_and_narrows_the_street():
    hints = batch(n=4)
    prediction = depth(hints, focal_log_error=(WRONG, WRONG))
    true = true_depth(hints, 1)
    known = (prediction.depth[1] > 0) & (true < 30)
    assert np.median(prediction.depth[1][known] / true[known]) == pytest.approx(1.0, abs=0.03)


@pytest.mark.parametrize("dial", ["depth_warp", "depth_drift"])
def test_depth_alone_bears_its_dials(dial):
    hints = batch(n=4)
    exact, wrong = depth(hints), depth(hints, **{dial: 0.1})
    assert np.array_equal(exact.T_s_c, wrong.T_s_c)
    known = exact.depth > 0
    ratio = wrong.depth[known] / exact.depth[known]
    assert 0.005 < np.abs(ratio - 1).max() < 0.35
    if dial == "depth_drift":
        per_view = [np.ptp(wrong.depth[v][known[v]] / exact.depth[v][known[v]]) for v in range(8)]
        assert max(per_view) < 1e-5


def test_depth_of_some_views_is_what_densify_gives():
    hints = batch(n=4)
    backbone = ScriptedBackbone(SCENE, ScriptedErrors(coupled=True, depth_warp=0.1))
    some, _ = backbone.depth(hints, np.array([2, 5]))
    assert np.array_equal(
        some, backbone.densify([], hints, backbone.infer([], hints)).depth[[2, 5]]
    )


def test_a_loop_keyframe_of_the_same_place_is_placed_truly():
    hints = batch(20, n=8, loop=17)
    prediction = infer(hints)
    assert prediction.loop_found
    assert np.abs(prediction.T_s_c[-1] - truth(SCENE, hints)[-1]).max() < 1e-4


@pytest.mark.parametrize("matches", [True, False])
def test_a_keyframe_of_another_place_is_put_near_one_of_the_batch(matches):
    hints = batch(40, n=8, loop=2)
    prediction = infer(hints, false_loop_matches=matches)
    apart = np.linalg.norm(prediction.T_s_c[:8, :3, 3] - prediction.T_s_c[-1, :3, 3], axis=1)
    assert apart.min() < 6.0 < np.linalg.norm(truth(SCENE, hints)[-1, :3, 3])
    assert np.any(prediction.landmarks.view == 16) == (matches and prediction.loop_found)
    assert np.abs(prediction.T_s_c[:16] - truth(SCENE, hints)[:16]).max() < 1e-4


def test_a_bent_path_is_an_arc_of_the_same_length():
    hints = batch()
    straight, bent = infer(hints).T_s_c[:10], infer(hints, bend_sigma_rad=0.1).T_s_c[:10]
    turn = se3.so3_log(np.swapaxes(straight[:, :3, :3], 1, 2) @ bent[:, :3, :3])[:, 1]
    assert abs(turn[9]) > 0.01 and np.allclose(turn, np.linspace(0, turn[9], 10), atol=2e-3)
    steps = [np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1) for T in (straight, bent)]
    assert np.allclose(*steps, rtol=0.02)
    aside = (bent[9, :3, 3] - straight[9, :3, 3])[0] / straight[9, 2, 3]
    assert aside == pytest.approx(turn[9] / 2, rel=0.1)
