"""Relative poses over stretches of a drive, and the sigmas claimed for them."""

from dataclasses import replace

import numpy as np
import pytest

from bench import relative_poses
from bench.relative_poses import Stretches, ends
from calm_edge.evaluation.truth import Truth
from calm_edge.geometry import se3
from calm_edge.types import PoseSample, PoseStatus
from tests.evaluation.worlds import curve, stamps


def test_a_stretch_begins_where_the_one_before_ends():
    along = np.arange(0, 3.5, 0.1)
    i, j = ends(along, 1.0, np.zeros(35, int))
    assert (i.tolist(), j.tolist()) == ([0, 10, 20], [10, 20, 30])


def test_no_stretch_crosses_a_gap_or_an_epoch():
    along = np.concatenate([np.arange(0, 1.55, 0.1), np.arange(3.0, 5.55, 0.1)])
    part = (along > 4.05).astype(int)
    i, j = ends(along, 1.0, part)
    assert len(i) == 3
    assert (part[i] == part[j]).all()
    np.testing.assert_allclose(along[j] - along[i], 1.0)


def test_a_drive_shorter_than_a_stretch_has_none():
    i, j = ends(np.arange(5.0), 100.0, np.zeros(5, int))
    assert len(i) == len(j) == 0


def _samples(T, t_ns, sigma, status=PoseStatus.LIVE):
    covariance = np.diag(np.square(sigma))
    return [
        PoseSample(int(t), pose, np.zeros(3), covariance, 0, status)
        for t, pose in zip(t_ns, T, strict=True)
    ]


def test_independent_errors_of_live_poses_have_normalised_errors_of_one():
    rng = np.random.default_rng(0)
    n = 2400
    T_truth, t_ns = curve(n), stamps(n)
    sigma = np.array([0.02, 0.01, 0.05, 0.001, 0.002, 0.001])
    T = T_truth @ se3.exp(rng.normal(size=(n, 6)) * sigma)
    found = relative_poses.of_live(
        _samples(T, t_ns, sigma), Truth(t_ns, T_truth), with_scale=False
    )["1 s"]
    assert len(found.error) == 239
    ratio = found.error / found.sigma
    np.testing.assert_allclose(np.sqrt((ratio**2).mean(0)), 1.0, atol=0.15)


def test_the_error_of_the_scale_is_common_to_both_ends():
    """One wrong scale for the drive: an error along the way, and its sigma there alone."""
    T_truth, t_ns = curve(240), stamps(240)
    T = T_truth.copy()
    T[:, :3, 3] *= 1.02
    samples = [
        replace(sample, scale_log_sigma=np.inf if k < 120 else 0.02)
        for k, sample in enumerate(_samples(T, t_ns, np.full(6, 1e-9)))
    ]
    found = relative_poses.of_live(samples, Truth(t_ns, T_truth))["1 s"]
    assert np.isnan(found.sigma[:11, :3]).all() and np.isfinite(found.sigma[:, 3:]).all()
    np.testing.assert_allclose(
        np.linalg.norm(found.error[12:, :3], axis=1),
        np.linalg.norm(found.sigma[12:, :3], axis=1),
        rtol=0.03,
    )


@pytest.mark.parametrize("status", [PoseStatus.LOST, PoseStatus.UNSCALED])
def test_lost_poses_and_those_without_a_metre_claim_nothing(status):
    T, t_ns = curve(30), stamps(30)
    lost = _samples(T, t_ns, np.ones(6), status)
    assert relative_poses.of_live(lost, Truth(t_ns, T)) == {}


def test_stretches_survive_json():
    table = Stretches(np.arange(12.0).reshape(2, 6), np.full((2, 6), np.nan), np.ones(2))
    again = Stretches.of_json(table.to_json())
    np.testing.assert_array_equal(again.error, table.error)
    np.testing.assert_array_equal(again.sigma, table.sigma)
    assert Stretches.of_json(Stretches.none().to_json()).error.shape == (0, 6)


@pytest.mark.parametrize("length", [1.0, 50.0])
def test_the_error_is_from_the_true_to_the_estimated_motion(length):
    T_truth = np.tile(np.eye(4), (2, 1, 1))
    T_truth[1, 2, 3] = length
    T = T_truth.copy()
    T[1, 2, 3] *= 1.01
    error = relative_poses.errors(T, T_truth, np.array([0]), np.array([1]))
    np.testing.assert_allclose(error, [[0, 0, 0.01 * length, 0, 0, 0]], atol=1e-9)


def test_a_wrong_focal_bends_the_path():
    """On a circle a share of the turn is missing; the effect is that of the turn made smaller."""
    n, yaw = 21, np.radians(2.0)
    step = se3.compose(se3.so3_exp(np.array([[0.0, yaw, 0.0]])), np.array([[0.0, 0.0, 1.0]]))[0]
    less = se3.compose(se3.so3_exp(np.array([[0, 0.99 * yaw, 0]])), np.array([[0, 0, 1.0]]))[0]
    T, bent = (np.stack([np.linalg.matrix_power(s, k) for k in range(n)]) for s in (step, less))
    i, j = np.array([0]), np.array([n - 1])
    expected = relative_poses.errors(bent, T, i, j)
    np.testing.assert_allclose(0.01 * relative_poses.focal_effect(T, i, j), expected, atol=2e-3)
    assert 0.01 * relative_poses.focal_effect(T, i, j)[0, 4] == pytest.approx(-0.01 * 20 * yaw)


def test_a_straight_path_does_not_depend_on_the_focal():
    T = np.tile(np.eye(4), (30, 1, 1))
    T[:, 2, 3] = np.arange(30.0)
    effect = relative_poses.focal_effect(T, np.array([0]), np.array([29]))
    np.testing.assert_allclose(effect, 0, atol=1e-9)


def test_a_turn_of_all_axes_is_a_motion_aside():
    """The derivatives are those of the motion between poses whose axes are all turned alike."""
    T, w = curve(60), np.array([0.0, 0.0, 0.0, 2e-4, -3e-4, 0.0])
    i, j = np.array([0, 20]), np.array([30, 59])
    turned = T @ se3.exp(w)
    expected = relative_poses.errors(turned, T, i, j)
    np.testing.assert_allclose(relative_poses.axes_effect(T, i, j) @ w[3:5], expected, atol=3e-6)
    assert np.abs(expected[:, :3]).max() > 1e-3
