from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
import pytest

from calm_edge.backbones.bundle.agreement import Agreement
from calm_edge.backbones.bundle.depth import (
    FARTHEST,
    PLANES,
    depth_views,
    judge,
    nearest_depth,
    neighbours,
    plane_count,
    sweep_window,
)
from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera, Perspective
from calm_edge.geometry.fisheye import Fisheye
from calm_edge.types import Float32, Hints, Landmarks, Prediction
from tests.backbones.bundle.board import pasted
from tests.synthetic.drive import exposed, make_rig
from tests.synthetic.render import render_views
from tests.synthetic.settings import Settings
from tests.synthetic.world import make_world

N = 4
SIZE = (320, 128)
SETTINGS = Settings(frames=2 * N, width=SIZE[0], height=SIZE[1], density=14.0, start_s=7.0)


@dataclass(frozen=True)
class Window:
    """N primary then N assistant pictures 0.2 s apart; truth (2N, h, w) z [spacings], 0 sky."""

    images: list
    hints: Hints
    prediction: Prediction
    truth: Float32


@pytest.fixture(scope="module")
def turn():
    rig = make_rig(make_world(SETTINGS.seed, SETTINGS.density), SETTINGS)
    scene = make_world(SETTINGS.seed, SETTINGS.density).scene
    rng = np.random.default_rng(0)
    images, truth, T, cameras = [], [], [], []
    for eye in (0, 1):
        T_w_c = rig.T_w_c[eye][::2]
        views, depths = render_views(scene, T_w_c, rig.cameras[eye])
        images += [exposed(view, 0.0, rng, SETTINGS) for view in views]
        truth += list(depths)
        T.append(T_w_c)
        cameras += [rig.cameras[eye]] * N
    T_s_c = se3.inverse(T[0][0]) @ np.concatenate(T)
    T_s_c[:, :3, 3] /= SETTINGS.spacing_m
    truth_s = np.stack(truth) / SETTINGS.spacing_m
    hints = Hints(eyes=np.repeat([0, 1], N), t_ns=np.tile(np.arange(N) * 200_000_000, 2))
    marks = landmarks(truth_s[0], cameras[0])
    return Window(images, hints, Prediction(tuple(cameras), T_s_c, landmarks=marks), truth_s)


def landmarks(depth: Float32, camera: Camera) -> Landmarks:
    """Every tenth pixel of view 0 as a point."""
    v, u = (a.ravel() for a in np.mgrid[0 : depth.shape[0] : 10, 0 : depth.shape[1] : 10])
    z = depth[v, u]
    keep = z > 0
    count = int(keep.sum())
    uv = np.stack([u, v], 1)[keep].astype(np.float32)
    points = camera.back_project(uv.astype(np.float64), z[keep])
    return Landmarks(points, np.arange(count), np.zeros(count, np.int64), uv)


def errors(window: Window, depth: Float32, confidence: Float32):
    """Relative error, confidence and whether there is a truth, of every pixel."""
    h, w = depth.shape[1:]
    truth = np.stack([cv2.resize(t, (w, h), interpolation=cv2.INTER_NEAREST) for t in window.truth])
    real = (truth > 0) & (truth < FARTHEST)
    return np.abs(depth / np.where(real, truth, 1) - 1), confidence, real


def test_confident_depth_is_right_and_confidence_ranks_error(turn):
    depth, confidence = sweep_window(turn.images, turn.hints, turn.prediction)
    assert depth.dtype == confidence.dtype == np.float32
    assert depth.shape == confidence.shape and len(depth) == 2 * N
    assert confidence.min() >= 0 and confidence.max() <= 1
    assert np.array_equal(confidence > 0, depth > 0)
    error, confidence, real = errors(turn, depth, confidence)
    sure = real & (confidence > 0.5)
    assert sure.sum() > 0.4 * real.sum()
    assert np.median(error[sure]) < 0.02
    assert (error[sure] < 0.1).mean() > 0.9
    known = real & (confidence > 0)
    order = np.argsort(-confidence[known])
    best, worst = np.array_split(error[known][order], 2)
    assert np.mean(best) < 0.6 * np.mean(worst)


def test_depth_of_every_second_view_in_fewer_pixels(turn):
    depth, confidence = sweep_window(turn.images, turn.hints, turn.prediction, 128, 2)
    assert depth.shape == (2 * N, 51, 128)
    kept = [0, 2, 4, 6]
    assert depth_views(turn.hints.eyes, False, 2).tolist() == kept
    assert [i for i in range(2 * N) if depth[i].any()] == kept
    error, confidence, real = errors(turn, depth, confidence)
    sure = real & (confidence > 0.5)
    assert sure[kept].sum() > 0.2 * real[kept].sum() and np.median(error[sure]) < 0.03


def test_smaller_depth_maps_have_fewer_planes_and_larger_ones_no_more():
    assert [plane_count(side) for side in (96, 192, 288)] == [PLANES // 2, PLANES, PLANES]


def test_a_loop_view_is_kept_and_matched_against_its_nearest(turn):
    eyes, T = np.append(turn.hints.eyes, 0), turn.prediction.T_s_c
    T = np.concatenate([T, T[:1]])
    t_ns = np.append(turn.hints.t_ns, -(10**12))
    kept = depth_views(eyes, True, 3)
    assert kept.tolist() == [0, 3, 4, 7, 8]
    found = neighbours(kept, eyes, t_ns, T, True)
    assert found[0] == [4, 3] and set(found[8]) == {0, 3, 4, 7}
    assert all(8 not in others for others in found.values())


def test_slightly_wrong_poses_and_focals_lose_little_depth(turn):
    rng = np.random.default_rng(1)
    shake = np.zeros((2 * N, 6))
    shake[:, 3:] = rng.normal(0, np.radians(0.02), (2 * N, 3))
    cameras = tuple(camera.with_focal(1.005 * camera.fx) for camera in turn.prediction.cameras)
    off = replace(turn.prediction, cameras=cameras, T_s_c=turn.prediction.T_s_c @ se3.exp(shake))
    depth, confidence = sweep_window(turn.images, turn.hints, off)
    error, confidence, real = errors(turn, depth, confidence)
    assert np.median(error[real & (confidence > 0.5)]) < 0.04


@pytest.mark.parametrize("wide", [False, True])
def test_depth_through_a_lens_is_that_of_its_pixels(turn, wide):
    """The same scene behind lenses of about the same field: pictures and truth are warped."""

    def lens(c):
        distortion = (0.3, 0.1) if wide else (-0.15, 0.04)
        kind = Fisheye if wide else Perspective
        return kind(c.fx, c.fy, c.cx, c.cy, c.width, c.height, distortion)

    lenses = tuple(map(lens, turn.prediction.cameras))
    images, truth = [], []
    pixels = np.stack(np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1])), -1).astype(np.float64)
    for behind, camera, image, z in zip(
        lenses, turn.prediction.cameras, turn.images, turn.truth, strict=True
    ):
        at = camera.project(behind.rays(pixels)).astype(np.float32)
        images.append(cv2.remap(image, at, None, cv2.INTER_LINEAR))
        truth.append(cv2.remap(z, at, None, cv2.INTER_NEAREST))
    behind = replace(turn, truth=np.stack(truth))
    prediction = replace(turn.prediction, cameras=lenses)
    depth, confidence = sweep_window(images, turn.hints, prediction)
    error, confidence, real = errors(behind, depth, confidence)
    sure = real & (confidence > 0.5)
    assert sure.sum() > 0.3 * real.sum()
    assert np.median(error[sure]) < 0.025
    assert (error[sure] < 0.1).mean() > 0.85


def test_black_pictures_have_no_depth(turn):
    black = [np.zeros_like(image) for image in turn.images]
    depth, confidence = sweep_window(black, turn.hints, turn.prediction)
    assert not confidence.any() and not depth.any()


def test_one_assistant_picture_without_landmarks_suffices(turn):
    keep = [0, 1, N]
    hints = Hints(eyes=np.array([0, 0, 1]), t_ns=turn.hints.t_ns[keep])
    prediction = Prediction(
        tuple(turn.prediction.cameras[i] for i in keep), turn.prediction.T_s_c[keep]
    )
    depth, _ = sweep_window([turn.images[i] for i in keep], hints, prediction)
    assert np.isfinite(depth).all() and (depth[0] > 0).mean() > 0.2


def test_agreement_becomes_confidence():
    # the last is sky, and its two neighbours are too close to it
    zeta = np.array([[0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.5 / FARTHEST]], np.float32)
    votes = np.array([[0, 1, 2, 2, 3, 3, 3]], np.float32)
    spread = np.array([[0, 0, 0, 0.005, 0, 0, 0]], np.float32)  # the fourth: five percent
    depth, confidence = judge(Agreement(zeta, votes, spread))
    assert depth == pytest.approx(np.array([[0, 10, 10, 10, 0, 0, 0]]))
    assert confidence == pytest.approx(np.array([[0, 1 / 2, 2 / 3, 1 / 3, 0, 0, 0]]))


def test_the_nearest_plane_follows_the_landmarks(turn):
    depths = turn.prediction.landmarks.points_s[:, 2]
    near = nearest_depth(turn.prediction)
    assert 0.5 * np.percentile(depths, 1) < near < np.percentile(depths, 1)


def test_a_van_that_comes_towards_us_gets_no_depth_and_what_stands_still_keeps_its(turn):
    """At our own speed it looks to one eye as if it stood still, at half the distance."""
    prediction = turn.prediction
    T_s_c = prediction.T_s_c
    step = T_s_c[N - 1, :3, 3] / (N - 1)
    # at first 40 spacings ahead; the assistant's pictures are taken at those of the primary's
    k = np.tile(np.arange(N), 2)
    T_s_van = np.tile(np.eye(4), (2 * N, 1, 1))
    T_s_van[:, :3, 3] = [0.0, 0.5, 40.0] - k[:, None] * step
    images, van = pasted(turn.images, prediction.cameras, T_s_c, T_s_van, (14.0, 10.0))
    hints = turn.hints
    kept, _ = sweep_window(images, hints, prediction)
    naive, _ = sweep_window(images, hints, prediction, reject_moving=False)
    size = kept.shape[:0:-1]
    inside = np.array([cv2.erode(v.astype(np.uint8), np.ones((9, 9))) for v in van])
    beside = np.array([cv2.dilate(v.astype(np.uint8), np.ones((25, 25))) == 0 for v in van])
    inside, beside = (
        np.array([cv2.resize(p, size, interpolation=cv2.INTER_NEAREST) > 0 for p in each])
        for each in (inside, beside.astype(np.uint8))
    )
    true = np.linalg.norm(T_s_van[:, :3, 3] - T_s_c[:, :3, 3], axis=1)[:, None, None]
    ghosts = [inside & (each > 0) & (np.abs(each / true - 1) > 0.2) for each in (naive, kept)]
    assert ghosts[0].sum() > 0.15 * inside.sum()
    assert ghosts[1].sum() < 0.2 * ghosts[0].sum()
    assert ((kept > 0) & beside).sum() > 0.97 * ((naive > 0) & beside).sum()
