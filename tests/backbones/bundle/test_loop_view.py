from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass, replace

import cv2
import numpy as np
import pytest

from calm_edge.backbones.bundle import loop_view
from calm_edge.backbones.bundle.backbone import BundleBackbone
from calm_edge.backbones.bundle.depth import loop_sources
from calm_edge.backbones.bundle.loop_view import LoopTracks, locate
from calm_edge.config import BackboneConfig
from calm_edge.geometry import se3
from calm_edge.geometry.camera import Perspective
from calm_edge.kit import layout
from calm_edge.recording.sequence_folder import ORIGIN_NS
from calm_edge.types import Float, Hints, KitBelief
from tests.synthetic.drive import exposed, make_rig
from tests.synthetic.render import render_views
from tests.synthetic.settings import Settings
from tests.synthetic.world import make_world

N = 8
LOOP = 2 * N
SETTINGS = Settings(frames=3 * N, width=320, height=128, density=14.0, start_s=6.0)
BACKBONE = BundleBackbone(BackboneConfig())
QUERY = 4
# where the car stood at its first visit, seen from the query view
T_QUERY_LOOP = se3.exp(np.array([0.3, 0.02, 0.7, 0.01, 0.04, 0.0]))


@dataclass(frozen=True)
class Batch:
    """N primary, N assistant pictures and a loop keyframe; pictures of another street."""

    images: list
    hints: Hints
    stranger: np.ndarray
    T_w_p: Float


@pytest.fixture(scope="module")
def batch() -> Batch:
    world = make_world(SETTINGS.seed, SETTINGS.density)
    rig, rng = make_rig(world, SETTINGS), np.random.default_rng(0)
    T_w_p, T_w_a = (rig.T_w_c[eye][::3] for eye in (0, 1))
    elsewhere = make_rig(world, replace(SETTINGS, start_s=1.0, frames=1)).T_w_c[0]
    images = []
    for eye, T_w_c in ((0, T_w_p), (1, T_w_a), (0, T_w_p[[QUERY]] @ T_QUERY_LOOP), (0, elsewhere)):
        views, _ = render_views(world.scene, T_w_c, rig.cameras[eye], oversample=1)
        images += [exposed(view, 0.0, rng, SETTINGS) for view in views]
    t = np.concatenate([rig.times[0][::3], rig.times[1][::3], [-300.0]])
    hints = Hints(
        eyes=np.r_[np.repeat([0, 1], N), 0],
        t_ns=ORIGIN_NS + 400_000_000_000 + np.round(t * 1e9).astype(np.int64),
        hfov_deg=SETTINGS.hfov_deg,
        sizes=np.array([(320, 128)] * 2),
        loop=True,
    )
    return Batch(images[:-1], hints, images[-1], T_w_p)


class Kept(BundleBackbone):
    """Keeps a copy of what it infers from the window alone, and of the pictures for it."""

    def infer(self, images, hints):
        found = super().infer(images, hints)
        if not hints.loop:
            self.alone, self.seen = deepcopy(found), (list(images), hints)
        return found


@pytest.fixture(scope="module")
def both(batch):
    """The window with the loop view, and without it as the same call has solved it."""
    backbone = Kept(BackboneConfig())
    solved = backbone.infer(batch.images, batch.hints)
    images, hints = backbone.seen
    # nothing of the loop view goes into the window
    assert all(a is b for a, b in zip(images, batch.images[:-1], strict=True))
    assert not hints.loop and len(hints.eyes) == len(hints.t_ns) == 2 * N
    return solved, backbone.alone


@pytest.fixture(scope="module")
def alone(both):
    return both[1]


@pytest.fixture(scope="module")
def solved(both):
    return both[0]


@pytest.fixture(scope="module")
def lost(batch, alone):
    """A picture of another street as loop keyframe."""
    return loop_view.with_loop([*batch.images[:-1], batch.stranger], batch.hints, alone)


def same_window(prediction, alone):
    parts = ("T_s_c", "focal_log_sigma")
    same = all(np.array_equal(getattr(prediction, p)[:-1], getattr(alone, p)) for p in parts)
    return same and prediction.cameras[:-1] == alone.cameras


def T_loop_error(prediction, batch):
    """(metres, degrees) of T_query_loop, the window's own scale taken from its true length."""
    T_s_p = prediction.T_s_c[:N]
    metres = np.linalg.norm((batch.T_w_p[-1] - batch.T_w_p[0])[:3, 3])
    metres /= np.linalg.norm((T_s_p[-1] - T_s_p[0])[:3, 3])
    T = se3.inverse(T_s_p[QUERY]) @ prediction.T_s_c[-1]
    T[:3, 3] *= metres
    off = se3.inverse(T_QUERY_LOOP) @ T
    return np.linalg.norm(off[:3, 3]), np.degrees(np.linalg.norm(se3.so3_log(off[:3, :3])))


def test_the_loop_view_is_placed_to_centimetres(solved, batch):
    assert solved.loop_found and len(solved.cameras) == len(solved.T_s_c) == 2 * N + 1
    metres, degrees = T_loop_error(solved, batch)
    assert metres < 0.05 and degrees < 0.2
    assert solved.cameras[-1] == solved.cameras[0]
    assert solved.focal_log_sigma[-1] == solved.focal_log_sigma[0]


def test_the_loop_view_does_not_change_the_window(solved, lost, alone):
    assert same_window(solved, alone) and same_window(lost, alone)
    assert np.array_equal(solved.kit.mean, alone.kit.mean)
    n = len(alone.landmarks.index)
    assert np.array_equal(solved.landmarks.uv[:n], alone.landmarks.uv)
    part = solved.without_loop()
    assert np.array_equal(part.landmarks.points_s, alone.landmarks.points_s)
    assert np.array_equal(part.landmarks.index, alone.landmarks.index)


def test_landmarks_of_the_loop_view_fit_its_pose(solved):
    marks = solved.landmarks
    rows = marks.view == LOOP
    assert rows.sum() >= loop_view.MIN_INLIERS
    p_c = se3.transform(se3.inverse(solved.T_s_c[LOOP]), marks.points_s[marks.index[rows]])
    miss = np.linalg.norm(solved.cameras[LOOP].project(p_c) - marks.uv[rows], axis=1)
    assert miss.max() < loop_view.POSE_PX and np.median(miss) < 1.0
    # each was seen by two views of the window at least
    seen = np.isin(marks.index, marks.index[rows]) & ~rows
    assert np.bincount(marks.index[seen])[marks.index[rows]].min() >= 2


def test_a_picture_of_another_street_is_not_found(lost, alone):
    assert not lost.loop_found
    assert np.array_equal(lost.T_s_c[-1], np.eye(4))
    assert LOOP not in lost.landmarks.view
    assert len(lost.landmarks.points_s) == len(alone.landmarks.points_s)


def test_the_same_batch_gives_the_same_bytes(solved, alone, batch):
    cv2.setRNGSeed(77)
    again = loop_view.with_loop(batch.images, batch.hints, alone)
    assert again.T_s_c.tobytes() == solved.T_s_c.tobytes()
    assert again.landmarks.uv.tobytes() == solved.landmarks.uv.tobytes()


def wider(hints, log_focal):
    """The hints with both focals known to be that much longer (log) than they are."""
    size = len(layout.prior((None, None)).mean)
    mean, information = np.zeros(size), np.zeros((size, size))
    for index, hfov in zip(layout.LOG_FOCAL, SETTINGS.hfov_deg, strict=True):
        mean[index] = -np.log(2 * np.tan(np.radians(hfov) / 2)) + log_focal
        information[index, index] = 0.002**-2
    return replace(hints, hfov_deg=(None, None), kit=KitBelief(mean, information))


def test_solving_again_places_the_loop_view_again_without_a_picture(solved, batch):
    again = BACKBONE.resolve(solved, batch.hints)
    assert again.loop_found and len(again.T_s_c) == 2 * N + 1
    metres, degrees = T_loop_error(again, batch)
    assert metres < 0.05 and degrees < 0.2
    moved = BACKBONE.resolve(solved, wider(batch.hints, 0.04))
    assert moved.loop_found and moved.cameras[-1].fx > 1.02 * solved.cameras[-1].fx
    # it goes with the window it is seen from, to another shape
    assert not np.allclose(moved.T_s_c[-1], again.T_s_c[-1], atol=1e-3)
    assert T_loop_error(moved, batch)[0] < 0.15


def test_solving_again_does_not_find_a_loop_view_that_was_not_found(lost, batch):
    again = BACKBONE.resolve(lost, batch.hints)
    assert not again.loop_found and len(again.T_s_c) == 2 * N + 1


def test_sigmas_stay_with_the_window(solved, alone):
    assert solved.landmarks.sigma_px is None
    sigma = np.arange(len(solved.landmarks.uv), dtype=np.float32)
    weighed = replace(solved, landmarks=replace(solved.landmarks, sigma_px=sigma))
    part = weighed.without_loop()
    assert len(part.landmarks.sigma_px) == len(alone.landmarks.uv)
    assert np.array_equal(
        solved.landmarks.uv[part.landmarks.sigma_px.astype(int)], part.landmarks.uv
    )
    again = loop_view.placed_again(part, weighed).landmarks
    assert len(again.sigma_px) == len(again.uv) > len(part.landmarks.uv)
    assert np.array_equal(again.sigma_px[: len(part.landmarks.uv)], part.landmarks.sigma_px)


def test_a_loop_view_whose_landmarks_fail_keeps_its_place_beside_the_nearest_view(solved):
    marks = solved.landmarks
    uv = marks.uv.copy()
    rows = np.flatnonzero(marks.view == LOOP)
    uv[rows] = np.random.default_rng(0).permutation(uv[rows])
    spoilt = replace(solved, landmarks=replace(marks, uv=uv))
    window = solved.without_loop()
    # the window comes out elsewhere and as large as before
    T_new_old = se3.exp(np.array([1.0, 2.0, 3.0, 0.1, 0.2, 0.3]))
    moved = replace(window, T_s_c=T_new_old @ window.T_s_c)
    again = loop_view.placed_again(moved, spoilt)
    assert again.loop_found
    assert np.allclose(again.T_s_c[-1], T_new_old @ solved.T_s_c[-1], atol=1e-9)


def few(batch, prediction, loop_image):
    """(images, hints, prediction) of three views an eye and the loop view."""
    views = [3, 4, 5, N + 3, N + 4, N + 5, LOOP]
    marks = prediction.landmarks
    rows = np.isin(marks.view, views)
    marks = replace(
        marks, index=marks.index[rows], view=np.searchsorted(views, marks.view[rows]),
        uv=marks.uv[rows], edge=marks.edge[rows],
    )  # fmt: skip
    images = [batch.images[v] for v in views[:-1]] + [loop_image]
    hints = replace(batch.hints, eyes=batch.hints.eyes[views], t_ns=batch.hints.t_ns[views])
    return images, hints, replace(
        prediction, cameras=tuple(prediction.cameras[v] for v in views),
        T_s_c=prediction.T_s_c[views], landmarks=marks,
    )  # fmt: skip


def test_the_loop_view_has_depth_only_with_a_pose(solved, lost, batch):
    dense = BACKBONE.densify(*few(batch, solved, batch.images[-1]))
    assert len(dense.depth) == len(dense.confidence) == 7
    assert (dense.confidence[-1] > 0.5).mean() > 0.1
    none = BACKBONE.densify(*few(batch, lost, batch.stranger))
    assert len(none.depth) == 7
    assert not none.depth[-1].any() and not none.confidence[-1].any()
    # nothing of the window is swept against the past
    assert np.array_equal(none.depth[:-1], dense.depth[:-1])


def test_the_loop_view_is_matched_against_near_views():
    T = np.tile(np.eye(4), (6, 1, 1))
    T[:, 2, 3] = [0, 3, 6, 9, 100, 6.5]
    assert loop_sources(T) == [2, 3, 1, 0]


def exact_tracks(n=60, seed=0, wrong=0):
    """Points before three views and a loop view, pixels exact but for `wrong` of the loop's."""
    rng = np.random.default_rng(seed)
    camera = Perspective.from_hfov(80, 640, 240)
    T_s_c = np.tile(np.eye(4), (3, 1, 1))
    T_s_c[1, :3, 3], T_s_c[2, :3, 3] = [0.1, 0, 3.0], [1.0, 0, 0.2]
    z = rng.uniform(8, 50, n)
    points = np.c_[rng.uniform(-0.6, 0.6, n) * z, rng.uniform(-0.2, 0.2, n) * z, z]
    seen = [camera.project(se3.transform(se3.inverse(T), points)) for T in T_s_c]
    loop_uv = camera.project(se3.transform(se3.inverse(T_QUERY_LOOP), points))
    loop_uv[:wrong] += rng.uniform(20, 60, (wrong, 2))
    point, view = np.tile(np.arange(n), 3), np.repeat([0, 1, 2], n)
    return (camera,) * 3, T_s_c, LoopTracks(point, view, np.concatenate(seen), loop_uv), points


def test_exact_tracks_with_outliers_give_the_exact_pose():
    cameras, T_s_c, tracks, points = exact_tracks(wrong=20)
    pose = locate(cameras, T_s_c, tracks)
    assert np.allclose(pose.T_s_c, T_QUERY_LOOP, atol=1e-6)
    assert np.array_equal(pose.inlier, np.arange(60) >= 20)
    assert pose.kept.all() and np.allclose(pose.points_s, points, rtol=1e-6)


def test_an_observation_off_its_point_is_dropped_and_the_point_kept():
    cameras, T_s_c, tracks, points = exact_tracks()
    uv = tracks.uv.copy()
    uv[5] += [3.0, 8.0]
    pose = locate(cameras, T_s_c, replace(tracks, uv=uv))
    assert pose is not None and not pose.kept[5]
    assert np.allclose(pose.points_s[6:], points[6:], rtol=1e-6)


@pytest.mark.parametrize(("n", "wrong"), [(15, 0), (60, 40)])
def test_too_few_agreeing_points_give_no_pose(n, wrong):
    cameras, T_s_c, tracks, _ = exact_tracks(n, wrong=wrong)
    assert locate(cameras, T_s_c, tracks) is None


def test_points_in_one_strip_give_no_pose():
    cameras, T_s_c, tracks, _ = exact_tracks()
    left = tracks.loop_uv[:, 0] < 160
    one_side = left[tracks.point]
    kept, point = np.unique(tracks.point[one_side], return_inverse=True)
    strip = LoopTracks(point, tracks.view[one_side], tracks.uv[one_side], tracks.loop_uv[kept])
    dense = replace(
        strip,
        point=np.concatenate([point + k * len(kept) for k in range(4)]),
        view=np.tile(strip.view, 4),
        uv=np.tile(strip.uv, (4, 1)),
        loop_uv=np.tile(strip.loop_uv, (4, 1)),
    )
    assert len(dense.loop_uv) > loop_view.MIN_INLIERS
    assert locate(cameras, T_s_c, dense) is None
