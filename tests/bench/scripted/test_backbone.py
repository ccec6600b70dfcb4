import dataclasses

import numpy as np
import pytest

from bench.scripted import ScriptedBackbone, ScriptedErrors
from calm_edge.backbones.base import BackboneError
from calm_edge.backbones.registry import open_backbone
from calm_edge.config import Config, merge
from calm_edge.geometry import se3
from calm_edge.geometry.camera import project_each
from calm_edge.recording.sequence_folder import ORIGIN_NS
from calm_edge.types import Hints
from tests.drives import PERIOD_NS, START_NS, T_P_A, curved, scene

T = curved(30)
SCENE = scene(T)


def hints(late_ns=17_000_000, first=4, n=6):
    t_ns = START_NS + PERIOD_NS * np.arange(first, first + n)
    return Hints(
        eyes=np.repeat([0, 1], n), t_ns=np.concatenate([t_ns, t_ns + late_ns]).astype(np.int64)
    )


def test_without_errors_it_plays_the_truth_at_any_stamp():
    prediction = ScriptedBackbone(SCENE).infer([], hints())
    true_p = se3.inverse(T[4]) @ T[4:10]
    true_a = se3.inverse(T[4]) @ se3.interpolate_at(np.arange(30), T, np.arange(4, 10) + 0.17)
    assert np.allclose(prediction.T_s_c[:6], true_p, atol=1e-12)
    assert np.allclose(prediction.T_s_c[6:], true_a @ T_P_A, atol=1e-9)
    assert prediction.cameras == tuple(SCENE.cameras[eye] for eye in hints().eyes)
    assert prediction.depth is None


def test_landmarks_project_where_they_were_seen():
    prediction = ScriptedBackbone(SCENE, ScriptedErrors(scale_log_sigma=0.7)).infer([], hints())
    marks = prediction.landmarks
    assert len(set(marks.view)) == 12
    assert np.bincount(marks.index).max() > 3
    p_s = marks.points_s[marks.index]
    T_c_s = se3.inverse(prediction.T_s_c)[marks.view]
    p_c = (T_c_s[:, :3, :3] @ p_s[..., None])[..., 0] + T_c_s[:, :3, 3]
    assert np.abs(project_each(prediction.cameras, marks.view, p_c) - marks.uv).max() < 1e-3


def test_depth_of_two_views_is_one_surface():
    backbone = ScriptedBackbone(SCENE, ScriptedErrors(scale_log_sigma=0.7))
    prediction = backbone.densify([], hints(), backbone.infer([], hints()))
    _, h, w = prediction.depth.shape
    scale = np.linalg.norm(prediction.T_s_c[1, :3, 3]) / np.linalg.norm((T[5] - T[4])[:3, 3])
    pixels = np.stack(np.meshgrid(np.arange(w), np.arange(h)), -1).astype(float)
    heights = []
    for view in (0, 3, 8):
        width, height = SCENE.size[hints().eyes[view]]
        camera = prediction.cameras[view].scaled(w / width, h / height)
        p_c = camera.back_project(pixels, prediction.depth[view].astype(float))
        p_w = se3.transform(T[4], se3.transform(prediction.T_s_c[view], p_c) / scale)
        heights.append(p_w[-1, :, 1])
    floor = T[:, 1, 3].max() + 1.65
    assert np.allclose(heights, floor, atol=1e-3)


@pytest.mark.parametrize(
    ("errors", "moved"),
    [
        (ScriptedErrors(scale_log_sigma=3.0), "scale"),
        (ScriptedErrors(focal_log_error=(0.1, -0.2)), "focal"),
        (ScriptedErrors(rotation_sigma_rad=0.01, translation_sigma=0.02), "poses"),
        (ScriptedErrors(match_sigma_px=0.5), "uv"),
        (ScriptedErrors(depth_warp=0.1), "depth"),
    ],
)
def test_each_error_moves_what_it_names_and_nothing_else(errors, moved):
    exact, wrong = (
        backbone.densify([], hints(), backbone.infer([], hints()))
        for backbone in (ScriptedBackbone(SCENE), ScriptedBackbone(SCENE, errors))
    )
    step = np.linalg.norm(wrong.T_s_c[1:6, :3, 3], axis=1) / np.linalg.norm(
        exact.T_s_c[1:6, :3, 3], axis=1
    )
    ratio = wrong.depth / exact.depth
    assert (moved == "focal") == (exact.cameras != wrong.cameras)
    assert (moved == "uv") == (not np.array_equal(exact.landmarks.uv, wrong.landmarks.uv))
    if moved == "scale":
        assert np.ptp(step) < 1e-9 and abs(step[0] - 1) > 0.01
        assert np.allclose(ratio, step[0], rtol=1e-5)
    elif moved == "poses":
        twist = se3.log(se3.inverse(exact.T_s_c) @ wrong.T_s_c)
        assert 0.01 < twist[:, :3].std() < 0.03 and 0.005 < twist[:, 3:].std() < 0.015
    else:
        assert np.array_equal(exact.T_s_c, wrong.T_s_c)
    if moved == "focal":
        ratios = [wrong.cameras[i].fx / exact.cameras[i].fx for i in (0, -1)]
        assert ratios == pytest.approx(np.exp([0.1, -0.2]))
    if moved == "depth":
        assert 0.02 < np.abs(ratio - 1).max() <= 0.1 + 1e-6
        assert np.abs(np.diff(ratio, axis=2)).max() < 0.05
    elif moved != "scale":
        assert np.array_equal(exact.depth, wrong.depth)


def test_errors_depend_on_the_stamps_alone():
    backbone = ScriptedBackbone(SCENE, ScriptedErrors(scale_log_sigma=0.3, translation_sigma=0.1))
    first = backbone.infer([], hints())
    other = backbone.infer([], hints(first=5))
    again = backbone.infer([], hints())
    assert np.array_equal(first.T_s_c, again.T_s_c)
    assert not np.allclose(first.T_s_c[1:5], other.T_s_c[1:5])
    reseeded = ScriptedErrors(scale_log_sigma=0.3, translation_sigma=0.1, seed=1)
    assert not np.allclose(first.T_s_c, ScriptedBackbone(SCENE, reseeded).infer([], hints()).T_s_c)


def test_stamps_outside_the_drive_are_refused():
    late = dataclasses.replace(hints(), t_ns=hints().t_ns + 10**10)
    with pytest.raises(BackboneError, match="outside"):
        ScriptedBackbone(SCENE).infer([], late)


def folder_config(folder):
    return merge(Config(), {"backbone": {"name": f"scripted:{folder}"}})


def test_a_folder_is_a_scene(tmp_path):
    np.savetxt(tmp_path / "poses0.txt", T[:, :3].reshape(-1, 12), fmt="%.17g")
    np.savetxt(tmp_path / "times0.txt", np.arange(30) * 0.25)
    np.savetxt(tmp_path / "T_p_a.txt", T_P_A[:3].reshape(1, 12), fmt="%.17g")
    (tmp_path / "calib.txt").write_text("200 201 99 49 200 100\n150 151 79 59 160 120\n")
    backbone = open_backbone(folder_config(tmp_path))
    asked = Hints(eyes=np.array([0, 0, 1]), t_ns=ORIGIN_NS + np.array([0, 250_000_000, 0]))
    prediction = backbone.infer([], asked)
    assert np.allclose(prediction.T_s_c[1:], [T[1], T_P_A], atol=1e-9)
    assert [camera.fy for camera in prediction.cameras] == [201, 201, 151]


def test_a_folder_of_poses_alone_takes_defaults(tmp_path):
    np.savetxt(tmp_path / "poses0.txt", T[:, :3].reshape(-1, 12), fmt="%.17g")
    backbone = open_backbone(folder_config(tmp_path))
    asked = Hints(eyes=np.array([0, 0, 1]), t_ns=ORIGIN_NS + np.array([0, 100_000_000, 0]))
    T_s_c = backbone.infer([], asked).T_s_c
    assert np.allclose(T_s_c[1], T[1], atol=1e-9)
    assert np.allclose(T_s_c[2, :3, 3], [1, 0, 0])


@pytest.mark.parametrize(
    ("files", "complaint"),
    [
        ({}, "poses0.txt: cannot be read"),
        ({"poses0.txt": "1 2 3\n"}, "poses0.txt: expected 12 numbers a row, found 3"),
        ({"poses0.txt": "a b\n"}, "poses0.txt: not a table"),
        ({"poses0.txt": "1 0 0 0 0 1 0 0 0 0 1 0\n"}, "need 2 or more"),
    ],
)
def test_a_folder_that_is_no_scene_says_why(tmp_path, files, complaint):
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    with pytest.raises(BackboneError, match=complaint):
        open_backbone(folder_config(tmp_path))


def test_a_missing_folder_name_says_so():
    with pytest.raises(BackboneError, match="scripted:FOLDER"):
        open_backbone(merge(Config(), {"backbone": {"name": "scripted"}}))
