"""Correspondences of an overlap: equal pixels give equal world points."""

from dataclasses import replace

import numpy as np
import pytest

from bench.baselines import overlap
from bench.baselines.overlap import BaselineError
from calm_edge.geometry import se3
from calm_edge.geometry.camera import Perspective
from calm_edge.types import Landmarks, Prediction, Submap
from tests.bench.baselines.chains import drive
from tests.drives import curved

SIZE = np.array([320, 160])
SMALL = (40, 80)
DRIVE = drive(curved(30))
A, B = DRIVE.submaps[:2]
VIEWS_A, VIEWS_B = overlap.common_views(A, B)
CAMERA = Perspective.from_hfov(80, *SIZE)


def wall_depth(T_w_c: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """(h, w) z-depth of the plane z = 60 + 0.3 x + 0.2 y of the world."""
    height, width = shape
    y, x = np.mgrid[:height, :width]
    share = np.array([width, height]) / SIZE
    uv = (np.stack([x, y], -1) + 0.5) / share - 0.5
    rays = CAMERA.back_project(uv, np.ones(shape)) @ T_w_c[:3, :3].T
    normal = np.array([-0.3, -0.2, 1.0])
    return np.asarray((60 - normal @ T_w_c[:3, 3]) / (rays @ normal))


def prediction(submap: Submap) -> Prediction:
    T_w_p = DRIVE.T_w_p[list(submap.primary_ids)]
    depth = np.stack([wall_depth(T, SMALL) for T in T_w_p]) / submap.scale
    n = len(T_w_p)
    return Prediction(
        cameras=(CAMERA,) * n,
        T_s_c=submap.T_s_c_raw,
        depth=depth.astype(np.float32),
        confidence=np.ones((n, *SMALL), np.float32),
    )


PREDICTION_A, PREDICTION_B = prediction(A), prediction(B)


def doubled(prediction: Prediction) -> Prediction:
    """Every depth pixel as four."""
    depth = prediction.depth.repeat(2, axis=1).repeat(2, axis=2)
    return replace(prediction, depth=depth, confidence=np.ones_like(depth))


def in_world(k: int, p_s: np.ndarray) -> np.ndarray:
    return se3.transform(np.linalg.inv(DRIVE.T_s_w[k]), p_s)


def found(a: Prediction = PREDICTION_A, b: Prediction = PREDICTION_B, stride: int = 4):
    return overlap.correspondences(a, VIEWS_A, b, VIEWS_B, SIZE, stride)


def test_common_pictures_are_the_last_and_the_first() -> None:
    assert VIEWS_A.tolist() == [12, 13, 14]
    assert VIEWS_B.tolist() == [0, 1, 2]


def test_both_lift_a_pixel_to_the_same_place() -> None:
    some = found()
    assert len(some.weight) == 3 * (40 // 4) * (80 // 4)
    assert np.allclose(in_world(0, some.previous), in_world(1, some.new), atol=1e-3)
    p_w = in_world(0, some.previous)
    assert np.allclose(p_w[:, 2], 60 + 0.3 * p_w[:, 0] + 0.2 * p_w[:, 1], atol=1e-3)


def test_depth_maps_of_different_sizes_meet_at_the_nearest_pixel() -> None:
    assert np.array_equal(found(b=doubled(PREDICTION_B)).new, found().new)
    assert len(found(a=doubled(PREDICTION_A)).new) == 4 * len(found().new)


def test_unknown_and_distrusted_pixels_are_left_out() -> None:
    depth, confidence = PREDICTION_A.depth.copy(), PREDICTION_B.confidence.copy()
    depth[:, :20] = 0
    depth[:, 20:22] = np.nan
    confidence[:, :, :40] = 0.09
    confidence[:, :, 40:] = 0.25
    some = found(
        replace(PREDICTION_A, depth=depth), replace(PREDICTION_B, confidence=confidence), 1
    )
    # a tenth of the lower median, 0.017: the weak half stays but weighs less
    assert len(some.weight) == 3 * 18 * 80
    assert sorted(set(some.weight.round(6))) == [0.3, 0.5]
    confidence[:, :, :40] = 0.01
    confidence[:, :, 30:40] = 0.25
    some = found(replace(PREDICTION_A), replace(PREDICTION_B, confidence=confidence), 1)
    assert len(some.weight) == 3 * 40 * 50


def test_depth_without_confidence_is_a_reason() -> None:
    with pytest.raises(BaselineError, match="lacks depth or confidence"):
        found(replace(PREDICTION_A, confidence=None))


def landmarks(points_s: np.ndarray, view: int, uv: np.ndarray) -> Landmarks:
    n = len(uv)
    return Landmarks(points_s, np.arange(n), np.full(n, view), uv.astype(np.float32))


def test_landmarks_meet_within_half_a_pixel_and_once() -> None:
    uv_a = np.array([[10.0, 10], [50, 50], [80, 20], [80.2, 20]])
    uv_b = np.array([[80.0, 20.1], [10.4, 10], [51, 50], [300, 100]])
    a = replace(PREDICTION_A, depth=None, landmarks=landmarks(np.eye(4, 3), 12, uv_a))
    b = replace(PREDICTION_B, depth=None, landmarks=landmarks(7 + np.eye(4, 3), 0, uv_b))
    some = found(a, b)
    assert some.previous.tolist() == np.eye(4, 3)[[0, 2]].tolist()
    assert some.new.tolist() == (7 + np.eye(4, 3))[[1, 0]].tolist()


def test_nothing_to_meet_is_nothing() -> None:
    bare = replace(PREDICTION_A, depth=None)
    assert len(found(bare).weight) == 0
    none = VIEWS_A[:0]
    assert len(overlap.from_depth(PREDICTION_A, none, PREDICTION_B, none, SIZE).new) == 0


def test_a_loop_keyframe_is_the_batch_s_last() -> None:
    with_loop = replace(B, T_s_c_raw=np.concatenate([B.T_s_c_raw, B.T_s_c_raw[:1]]))
    match, query = overlap.loop_views(A, with_loop, 4)
    assert (match.tolist(), query.tolist()) == ([4], [15])
    for submap, keyframe_id in ((B, 4), (with_loop, 99)):
        with pytest.raises(BaselineError, match="keyframe"):
            overlap.loop_views(A, submap, keyframe_id)
