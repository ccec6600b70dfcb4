from dataclasses import replace

import numpy as np
import pytest

from calm_edge.backbones.base import BackboneError
from calm_edge.backbones.bundle import initialise
from calm_edge.backbones.bundle.initialise import Rig
from calm_edge.geometry import se3
from calm_edge.kit import layout
from tests.backbones.bundle.exact_window import theta_of, turn, window

N = 8


@pytest.fixture(scope="module")
def exact():
    return window(turn(N), theta_of())


def rotation_deg(T, T_true):
    return np.degrees(np.linalg.norm(se3.log(se3.inverse(T_true) @ T)[..., 3:], axis=-1))


def guess_of(truth, factor):
    """The truth's optics with both focals off by a factor, and nothing of the rig."""
    theta = layout.prior((None, None)).mean
    theta[layout.EYE] = truth.theta[layout.EYE]
    theta[layout.LOG_FOCAL] += np.log(factor)
    return theta


def started(m, theta, rig, seed_share):
    """The initial state from a chain of resections."""
    poses = initialise.chained(m, theta, seed_share)
    return initialise.initial_state(m, theta, rig, poses)


@pytest.mark.parametrize("radial", [(0.0, 0.0), (-0.2, 0.05)])
def test_rays_undo_the_lens(radial):
    made = window(turn(N), theta_of(radial=radial))
    rays = initialise.normalised(made.m, made.truth.theta)
    q = (made.truth.T_c_s[made.m.view] @ made.truth.points[made.m.point][..., None])[..., 0]
    q = q[:, :2] / q[:, 2:3]
    # a lens with such terms folds what is farther from the axis into the picture
    unfolded = np.linalg.norm(q, axis=1) < 1.2
    assert unfolded.mean() > 0.95
    assert np.allclose(rays[unfolded], q[unfolded])


def test_rays_of_a_lens_that_folds_the_picture_are_finite(exact):
    theta = exact.truth.theta.copy()
    theta[layout.DISTORTION] = -2.0, 0.0
    assert np.isfinite(initialise.normalised(exact.m, theta)).all()


def test_a_point_seen_once_starts_far_ahead(exact):
    m = exact.m
    rows = (m.point != 3) | (np.cumsum(m.point == 3) == 1)
    thin = replace(m, view=m.view[rows], point=m.point[rows], uv=m.uv[rows])
    placed = initialise.triangulated(thin, exact.truth.T_c_s, exact.truth.theta)
    assert np.array_equal(placed[3], [0, 0, 1, 0])
    assert np.allclose(np.delete(placed, 3, 0), np.delete(exact.truth.points, 3, 0), atol=1e-9)


def test_the_right_focals_give_the_true_state(exact):
    state = started(exact.m, guess_of(exact.truth, 1.0), rig=Rig.FITTED, seed_share=0.5)
    assert np.abs(state.T_c_s - exact.truth.T_c_s).max() < 0.05
    assert np.allclose(state.theta, exact.truth.theta, atol=2e-3)


@pytest.mark.parametrize("factor", [0.8, 1.2])
def test_focals_wrong_by_a_fifth_give_a_state_to_start_from(exact, factor):
    state = started(exact.m, guess_of(exact.truth, factor), rig=Rig.FITTED, seed_share=0.5)
    truth = exact.truth
    # the turn of 33 degrees looks longer to a shorter focal
    assert rotation_deg(state.T_c_s, truth.T_c_s).max() < 10
    assert np.abs(np.diff(rotation_deg(state.T_c_s, truth.T_c_s)[:N])).max() < 3
    assert rotation_deg(layout.rig(state.theta), layout.rig(truth.theta)) < 2
    assert np.linalg.norm(state.theta[layout.RIG_CENTRE]) == pytest.approx(1)
    # lengths are in spacings, so the distance driven tells whether the spacing was found
    driven, true = (np.linalg.norm(se3.inverse(T[[0, N - 1]])[1, :3, 3] - se3.inverse(T[0])[:3, 3])
                    for T in (state.T_c_s, truth.T_c_s))  # fmt: skip
    assert 0.5 < driven / true < 2
    assert np.isfinite(state.points).all()
    assert np.allclose(np.linalg.norm(state.points, axis=1), 1)


@pytest.mark.parametrize("factor", [0.75, 1.3])
def test_the_assistants_focal_is_estimated_from_the_primarys_points(exact, factor):
    theta = guess_of(exact.truth, 1.0)
    theta[layout.LOG_FOCAL[1]] += np.log(factor)
    state = started(exact.m, theta, rig=Rig.FITTED, seed_share=0.5)
    assert np.allclose(state.theta, exact.truth.theta, atol=5e-3)


def test_the_path_of_a_car_gives_the_true_state_too(exact):
    paths = list(initialise.driven(exact.m, exact.truth.theta, None))
    # steps by their ratios, then of a constant speed
    assert len(paths) == 2
    for poses in paths:
        state = initialise.initial_state(exact.m, exact.truth.theta, Rig.KNOWN, poses)
        assert rotation_deg(state.T_c_s, exact.truth.T_c_s).max() < 0.5
        moved = np.linalg.norm(se3.inverse(state.T_c_s)[:, :3, 3], axis=1)
        true = np.linalg.norm(se3.inverse(exact.truth.T_c_s)[:, :3, 3], axis=1)
        assert np.allclose(moved[true > 1] / true[true > 1], 1, atol=0.3)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_an_assistant_abreast_of_the_primary_is_found_on_either_side(side):
    theta = theta_of()
    theta[layout.RIG_CENTRE] = np.array([0.995 * side, 0.04, 0.09])
    theta[layout.RIG_CENTRE] /= np.linalg.norm(theta[layout.RIG_CENTRE])
    made = window(turn(N), theta)
    state = started(made.m, guess_of(made.truth, 1.0), rig=Rig.ABREAST, seed_share=0.5)
    assert np.array_equal(state.theta[layout.RIG_CENTRE], [side, 0, 0])
    assert rotation_deg(layout.rig(state.theta), layout.rig(theta)) < 1
    length, true = (
        np.linalg.norm(se3.inverse(T[N - 1])[:3, 3]) for T in (state.T_c_s, made.truth.T_c_s)
    )
    assert length == pytest.approx(true, rel=0.1)


def test_a_known_rig_is_kept_and_sets_the_scale(exact):
    state = started(exact.m, exact.truth.theta, rig=Rig.KNOWN, seed_share=0.5)
    assert np.allclose(state.theta, exact.truth.theta)
    assert np.abs(state.T_c_s - exact.truth.T_c_s).max() < 0.05


def test_an_assistant_on_the_other_side_of_the_known_rig_raises(exact):
    theta = exact.truth.theta.copy()
    theta[layout.RIG_CENTRE] *= -1
    with pytest.raises(
        BackboneError, match=r"^bundle: the rig does not fit the matches between the cameras$"
    ):
        started(exact.m, theta, rig=Rig.KNOWN, seed_share=0.5)


def kept(m, rows):
    return replace(m, view=m.view[rows], point=m.point[rows], uv=m.uv[rows])


def test_without_matches_between_the_eyes_it_raises(exact):
    m = kept(exact.m, exact.m.eye[exact.m.view] == 0)
    with pytest.raises(BackboneError, match=r"^bundle: no matches between the cameras; let"):
        started(m, exact.truth.theta, rig=Rig.FITTED, seed_share=0.5)


def test_a_first_keyframe_without_matches_raises(exact):
    m = kept(exact.m, exact.m.view != 0)
    with pytest.raises(BackboneError, match=r"^bundle: the first keyframes share too few"):
        started(m, exact.truth.theta, rig=Rig.FITTED, seed_share=0.5)


def test_a_keyframe_without_matches_raises(exact):
    m = kept(exact.m, exact.m.view != 5)
    with pytest.raises(BackboneError, match=r"^bundle: a keyframe shares too few"):
        started(m, exact.truth.theta, rig=Rig.FITTED, seed_share=0.5)
