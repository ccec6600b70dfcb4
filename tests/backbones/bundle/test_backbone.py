from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
import pytest

from calm_edge.backbones.base import BackboneError
from calm_edge.backbones.bundle import backbone as bundle
from calm_edge.backbones.bundle import tracks, window
from calm_edge.config import BackboneConfig
from calm_edge.geometry import se3
from calm_edge.geometry.camera import project_each
from calm_edge.geometry.fisheye import Fisheye
from calm_edge.geometry.polyline import path_length
from calm_edge.geometry.similarity import align
from calm_edge.kit import layout
from calm_edge.kit.belief import product
from calm_edge.kit.lens import Family
from calm_edge.recording.sequence_folder import ORIGIN_NS
from calm_edge.types import Float, Hints, KitBelief, Prediction
from tests.backbones.bundle import exact_window
from tests.synthetic.drive import exposed, make_rig
from tests.synthetic.render import render_views
from tests.synthetic.settings import Settings
from tests.synthetic.shots import T_primary_assistant
from tests.synthetic.world import make_world

N = 8
SETTINGS = Settings(frames=3 * N, width=320, height=128, density=14.0)
BACKBONE = bundle.BundleBackbone(BackboneConfig())
T_P_A = T_primary_assistant(SETTINGS)


@dataclass(frozen=True)
class Batch:
    """N primary then N assistant pictures, 0.3 s apart, and their truth."""

    images: list
    hints: Hints
    T_w_c: Float
    f: Float

    def infer(self, **hints) -> Prediction:
        return BACKBONE.infer(self.images, replace(self.hints, **hints))


@pytest.fixture(scope="module")
def drive():
    world = make_world(SETTINGS.seed, SETTINGS.density)

    def driven(start_s):
        settings = replace(SETTINGS, start_s=start_s)
        rig, rng, size = make_rig(world, settings), np.random.default_rng(0), (320, 128)
        images, poses = [], []
        for eye in (0, 1):
            poses.append(rig.T_w_c[eye][::3])
            views, _ = render_views(world.scene, poses[-1], rig.cameras[eye], oversample=1)
            images += [exposed(view, 0.0, rng, settings) for view in views]
        t = np.concatenate([rig.times[eye][::3] for eye in (0, 1)])
        hints = Hints(
            eyes=np.repeat([0, 1], N),
            t_ns=ORIGIN_NS + np.round(t * 1e9).astype(np.int64),
            sizes=np.array([size, size]),
        )
        f = np.array([camera.fx for camera in rig.cameras])
        return Batch(images, hints, np.concatenate(poses), f)

    return driven


@pytest.fixture(scope="module")
def turn(drive):
    return drive(6.0)


@pytest.fixture(scope="module")
def straight(drive):
    return drive(1.0)


@pytest.fixture(scope="module")
def solved(turn):
    return turn.infer()


@pytest.fixture(scope="module")
def solved_straight(straight):
    return straight.infer()


def log_focal_error(prediction, batch):
    return np.log([prediction.cameras[view].fx for view in (0, N)] / batch.f)


def rig_of(prediction, batch):
    """(N, 4, 4) T_p_a as the poses have it, each at the assistant's own instant."""
    t = (batch.hints.t_ns - batch.hints.t_ns[0]) * 1e-9
    exposed = t[N:] + prediction.assistant_late_s
    T_s_p = se3.interpolate_at(t[:N], prediction.T_s_c[:N], exposed)
    return se3.inverse(T_s_p) @ prediction.T_s_c[N:]


def shape_error(prediction, batch):
    """(share of the length driven, metres a unit) after the best similarity."""
    p, p_true = prediction.T_s_c[:, :3, 3], batch.T_w_c[:, :3, 3]
    fit = align(p, p_true, with_scale=True)
    error = np.linalg.norm(fit.points(p) - p_true, axis=1)
    return np.sqrt((error**2).mean()) / path_length(p_true[:N]), fit.scale


def test_a_turn_determines_both_focals_and_their_sigmas(solved, turn):
    error, sigma = log_focal_error(solved, turn), solved.focal_log_sigma[[0, N]]
    assert np.abs(error).max() < 0.03
    assert (np.abs(error) < 3 * sigma).all()
    assert (sigma < 0.1).all()
    assert np.array_equal(solved.focal_log_sigma, sigma[turn.hints.eyes])


def test_a_turn_has_the_true_shape_and_scale(solved, turn):
    error, metres_a_spacing = shape_error(solved, turn)
    assert error < 0.01
    assert metres_a_spacing == pytest.approx(SETTINGS.spacing_m, rel=0.05)
    turned = se3.log(se3.inverse(solved.T_s_c[0]) @ solved.T_s_c[N - 1])[3:]
    true = se3.log(se3.inverse(turn.T_w_c[0]) @ turn.T_w_c[N - 1])[3:]
    assert np.linalg.norm(true) > 0.8 and np.linalg.norm(turned - true) < 0.02


def test_the_spacing_is_one_and_the_rig_is_the_true_one(solved, turn):
    T_p_a = rig_of(solved, turn)
    assert np.linalg.norm(T_p_a[:, :3, 3], axis=1) == pytest.approx(np.ones(N), abs=0.02)
    off = se3.so3_log(T_p_a[:, :3, :3].swapaxes(1, 2) @ T_P_A[:3, :3])
    # only the prior, of 0.02 widths, separates a turn of the rig from a shift of a principal point
    assert np.degrees(np.linalg.norm(off, axis=1)).max() < 0.7
    assert np.array_equal(solved.T_s_c[0], np.eye(4))


def test_landmarks_fit_their_poses_and_focals(solved):
    marks = solved.landmarks
    T_c_s = se3.inverse(solved.T_s_c)[marks.view]
    q = (T_c_s[:, :3, :3] @ marks.points_s[marks.index][..., None])[..., 0] + T_c_s[:, :3, 3]
    error = np.linalg.norm(project_each(solved.cameras, marks.view, q) - marks.uv, axis=1)
    assert np.median(error) < 0.4 and (error < window.KEPT_PX + 0.2).all()
    assert len(marks.points_s) > 150


def test_a_straight_drive_has_the_true_shape_and_a_large_focal_sigma(solved_straight, straight):
    error, sigma = log_focal_error(solved_straight, straight), solved_straight.focal_log_sigma
    assert (sigma > 0.05).all()
    assert (np.abs(error) < 3 * sigma[[0, N]]).all()
    assert shape_error(solved_straight, straight)[0] < 0.01


def test_the_scale_is_known_no_better_than_the_focals(solved_straight):
    """An error of both focals is one of the parallax, and that of the scale."""
    assert solved_straight.scale_log_sigma >= solved_straight.focal_log_sigma.min()


def sharp(log_focal, sigma):
    """A belief on the two focals alone."""
    mean, information = np.zeros(layout.SIZE), np.zeros((layout.SIZE, layout.SIZE))
    focals = layout.LOG_FOCAL
    mean[focals], information[focals, focals] = log_focal, sigma**-2
    return KitBelief(mean, information)


def test_resolving_under_a_sharper_kit_moves_the_focal_there(solved_straight, straight):
    wanted = np.log(straight.f / 320) + 0.06
    hints = replace(straight.hints, kit=sharp(wanted, 0.003))
    moved = BACKBONE.resolve(solved_straight, hints)
    assert log_focal_error(moved, straight) == pytest.approx([0.06, 0.06], abs=0.01)
    assert (moved.focal_log_sigma < 0.02).all()
    # a straight drive keeps its shape under another focal
    assert shape_error(moved, straight)[0] < 0.01


def test_resolving_under_the_same_belief_changes_little(solved, turn):
    again = BACKBONE.resolve(solved, turn.hints)
    moved = log_focal_error(again, turn) - log_focal_error(solved, turn)
    assert (np.abs(moved) < 0.5 * solved.focal_log_sigma[[0, N]]).all()
    apart = np.linalg.norm((again.T_s_c - solved.T_s_c)[:, :3, 3], axis=1).max()
    assert apart < 0.02 * path_length(solved.T_s_c[:N, :3, 3])


def test_resolving_reads_no_picture(solved, turn, monkeypatch):
    monkeypatch.setattr(window, "measure", None)
    assert BACKBONE.resolve(solved, turn.hints).landmarks is not None
    with pytest.raises(BackboneError, match="cannot be solved again"):
        BACKBONE.resolve(replace(solved, landmarks=None), turn.hints)


def arrays(prediction):
    marks, belief = prediction.landmarks, prediction.kit
    K = np.array([camera.matrix for camera in prediction.cameras])
    return [
        K, prediction.T_s_c, prediction.focal_log_sigma,
        marks.points_s, marks.index, marks.view, marks.uv, belief.mean, belief.information,
    ]  # fmt: skip


def test_the_same_call_gives_the_same_bytes(solved, turn, solved_straight):
    other = bundle.BundleBackbone(BackboneConfig())
    before = [image.tobytes() for image in turn.images]
    cv2.setRNGSeed(12345)
    again = other.infer(turn.images, turn.hints)
    for a, b in zip(arrays(solved), arrays(again), strict=True):
        assert a.dtype == b.dtype and a.tobytes() == b.tobytes()
    assert [image.tobytes() for image in turn.images] == before


def test_evidence_of_turns_determines_a_straight_drive(
    solved, straight, solved_straight, drive, monkeypatch
):
    second = drive(6.5).infer(kit=solved.kit)
    # two such turns, each driven twice
    belief = product([solved.kit, second.kit] * 2)
    # the rig is known: nothing is searched between the eyes
    monkeypatch.setattr(tracks, "sift_homography", None)
    informed = straight.infer(kit=belief)
    error, sigma = log_focal_error(informed, straight), informed.focal_log_sigma
    assert np.abs(error).max() < 0.04
    assert (np.abs(error) < 3 * sigma[[0, N]]).all()
    assert (sigma < 0.5 * solved_straight.focal_log_sigma).all()
    assert shape_error(informed, straight)[0] < 0.01
    off = se3.so3_log(rig_of(informed, straight)[:, :3, :3].swapaxes(1, 2) @ T_P_A[:3, :3])
    assert np.degrees(np.linalg.norm(off, axis=1)).max() < 0.5
    # its evidence excludes the belief of the hints
    own = np.linalg.inv(product([layout.prior((None, None)), informed.kit]).information)
    assert np.sqrt(own[0, 0]) > 0.1


def test_a_hint_of_the_field_of_view_is_used(straight):
    hinted = straight.infer(hfov_deg=SETTINGS.hfov_deg)
    assert np.abs(log_focal_error(hinted, straight)).max() < 0.005
    assert (hinted.focal_log_sigma < 0.02).all()


def test_black_pictures_raise(turn):
    black = [np.zeros_like(image) for image in turn.images]
    with pytest.raises(BackboneError, match=r"^bundle: only 0 points could be followed"):
        BACKBONE.infer(black, turn.hints)


def test_eyes_that_see_different_places_raise(turn, straight):
    """Nothing matches across: an assistant that looks the other way cannot give the unit."""
    swapped = turn.images[:N] + [image[::-1, ::-1].copy() for image in straight.images[N:]]
    with pytest.raises(BackboneError, match=r"^bundle: [^\n]+$"):
        BACKBONE.infer(swapped, turn.hints)


def with_pixels(prediction, uv):
    return replace(prediction, landmarks=replace(prediction.landmarks, uv=uv.astype(np.float32)))


def test_matches_that_fit_no_rigid_scene_raise(solved, turn):
    shuffled = np.random.default_rng(0).permutation(solved.landmarks.uv)
    with pytest.raises(BackboneError, match="do not fit one rigid scene"):
        BACKBONE.resolve(with_pixels(solved, shuffled), turn.hints)


def test_a_poor_fit_is_no_evidence_on_the_kit(solved, turn):
    rng = np.random.default_rng(0)
    uv = solved.landmarks.uv + 1.1 * rng.standard_normal(solved.landmarks.uv.shape)
    poor = BACKBONE.resolve(with_pixels(solved, uv), turn.hints)
    assert poor.kit is None and solved.kit is not None
    # that of the prior, and how far the solution is from it
    assert (poor.focal_log_sigma >= 0.30).all()


def test_existing_depth_is_kept(solved, turn):
    depth = np.ones((2 * N, 4, 8), np.float32)
    dense = replace(solved, depth=depth, confidence=depth)
    assert BACKBONE.densify(turn.images, turn.hints, dense) is dense


def test_the_belief_is_the_prior_times_the_evidence_of_others(solved):
    informed = bundle.kit_belief(
        Hints(eyes=np.array([0, 1]), t_ns=np.zeros(2, int), hfov_deg=(78.0, None), kit=solved.kit)
    )
    prior = layout.prior((78.0, None))
    assert np.allclose(informed.information, prior.information + solved.kit.information)
    assert np.linalg.norm(informed.mean[layout.RIG_CENTRE]) == pytest.approx(1, abs=1e-12)
    alone = bundle.kit_belief(Hints(eyes=np.array([0, 1]), t_ns=np.zeros(2, int)))
    assert np.array_equal(alone.mean, layout.prior((None, None)).mean)


def test_a_wrong_tail_is_rejected_behind_a_right_median(solved, turn):
    uv = solved.landmarks.uv.copy()
    wrong = np.random.default_rng(0).random(len(uv)) < 0.2
    uv[wrong] += [40.0, 25.0]
    with pytest.raises(BackboneError, match="do not fit one rigid scene"):
        BACKBONE.resolve(with_pixels(solved, uv), turn.hints)


def test_a_belief_in_the_wrong_family_of_lenses_is_given_up_before_the_focals_are_known():
    """Fisheye lenses of 120 degrees, where earlier windows said perspective ones."""
    theta = exact_window.theta_of()
    theta[layout.FAMILY], theta[layout.DISTORTION] = Family.FISHEYE, 0.0
    theta[layout.LOG_FOCAL] = -np.log(np.radians(120))
    m = exact_window.window(exact_window.turn(6), theta, noise_px=0.2).m
    belief = layout.prior((None, None))
    information = np.zeros_like(belief.information)
    information[layout.LOG_FOCAL, layout.LOG_FOCAL] = 0.08**-2.0
    t_ns = ORIGIN_NS + np.round(m.t * 1e9).astype(np.int64)
    hints = Hints(m.eye, t_ns, sizes=exact_window.SIZE, kit=KitBelief(belief.mean, information))
    found = BACKBONE._of_other_lenses(m, hints)
    assert found is not None
    primary, assistant = found[0].cameras[0], found[0].cameras[-1]
    assert isinstance(primary, Fisheye) and isinstance(assistant, Fisheye)
    f = np.exp(theta[layout.LOG_FOCAL]) * exact_window.SIZE[:, 0]
    assert np.allclose([primary.fx, assistant.fx], f, rtol=0.03)
    known = replace(hints, kit=KitBelief(belief.mean, 4 * information))
    assert BACKBONE._of_other_lenses(m, known) is None
