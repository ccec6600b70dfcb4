"""Trajectory errors of trajectories with known errors."""

import numpy as np
import pytest

from calm_edge.evaluation import trajectory
from calm_edge.geometry import se3
from calm_edge.geometry.similarity import align
from tests.evaluation.worlds import curve, stamps


def _moved(T: np.ndarray, scale: float, w: np.ndarray, t: np.ndarray) -> np.ndarray:
    R = se3.so3_exp(w)
    return se3.compose(R @ T[:, :3, :3], scale * T[:, :3, 3] @ R.T + t)


def test_rigid_alignment_keeps_the_scale_error() -> None:
    truth = curve()
    T = _moved(truth, 1.1, np.array([0.3, 1.0, -2.0]), np.array([5.0, 6, 7]))
    p, p_truth = T[:, :3, 3], truth[:, :3, 3]
    rigid = align(p, p_truth, with_scale=False)
    spread = np.sqrt(((p_truth - p_truth.mean(0)) ** 2).sum(1).mean())
    assert rigid.scale == 1
    assert trajectory.ate(rigid.points(p), p_truth) == pytest.approx(0.1 * spread, rel=1e-9)


def test_ate_of_known_noise() -> None:
    truth = curve(3000)[:, :3, 3]
    noisy = truth + np.random.default_rng(1).normal(0, 0.2, truth.shape)
    aligned = align(noisy, truth, with_scale=False).points(noisy)
    assert trajectory.ate(aligned, truth) == pytest.approx(0.2 * np.sqrt(3), rel=0.03)


def test_rpe_of_known_drift() -> None:
    n = 101
    truth = se3.compose(np.tile(np.eye(3), (n, 1, 1)), np.arange(n)[:, None] * [0, 0, 1.0])
    longer = truth.copy()
    longer[:, 2, 3] *= 1.03
    assert trajectory.rpe(longer, truth) == pytest.approx((3.0, 0.0), abs=1e-9)
    # the camera turns by 0.2 degrees per metre on an exact path: only rotation is wrong
    turning = truth.copy()
    turning[:, :3, :3] = se3.so3_exp(np.radians(0.2) * np.arange(n)[:, None] * [0, 0, 1.0])
    trans, rot = trajectory.rpe(turning, truth) or (0, 0)
    assert (trans, rot) == pytest.approx((0.0, 0.2), abs=1e-9)


def test_rpe_does_not_depend_on_the_world_frame_and_is_none_on_short_paths() -> None:
    truth = curve(60)
    T = np.asarray(se3.exp(np.array([4.0, 5, 6, 0.5, 1, 2])) @ truth)
    assert trajectory.rpe(T, truth) == pytest.approx((0, 0), abs=1e-6)
    assert trajectory.rpe(truth[:8], truth[:8]) is None


def test_scale_windows_follow_a_growing_scale() -> None:
    n = 301
    truth = np.arange(n)[:, None] * [0, 0, 1.0]
    steps = np.where(np.arange(n) < 150, 1.0, 1.2)[:, None] * [0, 0, 1.0]
    starts, scales = trajectory.window_scales(np.cumsum(steps, 0), truth)
    assert starts[:3].tolist() == [0, 5, 10]
    assert len(scales) == 41
    assert scales[0] == 1 and scales[-1] == pytest.approx(1.2)
    figures = trajectory.scale_consistency(np.cumsum(steps, 0), truth)
    assert figures == pytest.approx((np.mean(scales - 1), np.std(scales)))


def test_spans_without_motion_have_no_scale() -> None:
    # 15 s of driving, 20 s of standing and creeping by 0.2 m, 15 s of driving, at 10 Hz
    along = np.cumsum(np.repeat([1.0, 0.001, 1.0], [150, 200, 150]))
    truth = along[:, None] * [0, 0, 1.0]
    p = 0.5 * truth + np.random.default_rng(0).normal(0, 0.05, truth.shape)
    starts, _ = trajectory.window_scales(p, truth)
    assert not {*starts.tolist()} & {*range(150, 250)} and {155 - 100, 255} <= {*starts.tolist()}
    mean, std = trajectory.scale_consistency(p, truth) or (9, 9)
    assert mean < 0.1 and std < 0.1
    still = truth[150:300]
    assert len(trajectory.window_scales(p[150:300], still)[1]) == 0
    assert trajectory.scale_consistency(p[150:300], still) is None


def test_a_path_that_stays_at_its_start_does_not_move() -> None:
    circle = 0.04 * np.stack([np.cos(np.arange(900)), np.sin(np.arange(900)), np.zeros(900)], 1)
    assert not trajectory.moves(circle) and not trajectory.moves(np.zeros((0, 3)))
    assert trajectory.moves(np.array([[0, 0, 0], [0, 0, 0.2]]))


def test_scale_consistency_ignores_the_unit_and_needs_105_frames() -> None:
    p = curve(105)[:, :3, 3]
    assert trajectory.scale_consistency(0.3 * p, p) == pytest.approx((0, 0), abs=1e-12)
    assert trajectory.scale_consistency(p[:104], p[:104]) is None


def test_association_prefers_the_exact_stamp_and_uses_each_once() -> None:
    truth = stamps(5)
    t = np.sort(np.array([truth[0] + 4_000_000, truth[2] - 3_000_000, truth[2], truth[4] + 1]))
    i, j = trajectory.associate(t, truth)
    assert i.tolist() == [0, 2, 3]
    assert j.tolist() == [0, 2, 4]


def test_association_beyond_tolerance_and_of_empty_series() -> None:
    truth = stamps(3)
    assert len(trajectory.associate(truth + 11_000_000, truth)[0]) == 0
    assert len(trajectory.associate(truth + 10_000_000, truth)[0]) == 3
    assert len(trajectory.associate(truth[:0], truth)[0]) == 0
    assert trajectory.associate(truth, truth[1:2])[0].tolist() == [1]
