"""Errors of live poses with simulated faults."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calm_edge.evaluation import results
from calm_edge.evaluation.estimate import Estimate
from calm_edge.evaluation.live import compare, spans
from calm_edge.evaluation.truth import Truth
from calm_edge.geometry import se3
from calm_edge.types import PoseSample, PoseStatus
from tests.evaluation.worlds import STEP_NS, curve, stamps

N = 80
NONE = np.full((4, 4), np.nan), np.full(3, np.nan), np.full((6, 6), np.nan)


def samples(T: np.ndarray, lost: range = range(0), epoch_from: int = 10**9) -> list[PoseSample]:
    """One pose per frame, in a world other than the truth's, with the true velocity."""
    T_o_w = se3.exp(np.array([5.0, 1.0, -2.0, 0.0, 0.8, 0.0]))
    out = []
    for i, (t, T_w_c) in enumerate(zip(stamps(len(T)).tolist(), T, strict=True)):
        if i in lost:
            out.append(PoseSample(t, *NONE, 0, PoseStatus.LOST))
            continue
        beside = T[min(i + 1, len(T) - 1), :3, 3] - T[max(i - 1, 0), :3, 3]
        velocity = T_w_c[:3, :3].T @ beside / (2 * STEP_NS / 1e9)
        epoch = int(i >= epoch_from)
        status = PoseStatus.LIVE if i % 2 else PoseStatus.LAGGING
        sample = PoseSample(t, T_o_w @ T_w_c, velocity, np.eye(6), epoch, status)
        out.append(replace(sample, twist_covariance=np.eye(6), scale_log_sigma=0.01))
    return out


def test_the_truth_in_another_frame_is_without_error() -> None:
    T = curve(N)
    figures = compare(samples(T), stamps(N), stamps(N), T)
    assert figures is not None
    assert figures["first_s"] == 0 and figures["live_percent"] == 100 and figures["jumps"] == 0
    assert figures["span_m"]["max"] < 1e-9 and figures["span_deg"]["max"] < 1e-5
    assert figures["velocity_m_s"]["max"] < 1e-9


def test_a_wrong_scale_shows_in_percent_and_can_be_passed() -> None:
    T = curve(N)
    small = T.copy()
    small[:, :3, 3] *= 0.9
    figures = compare(samples(small), stamps(N), stamps(N), T)
    assert figures is not None and figures["span_percent"] == pytest.approx(10, abs=0.01)
    assert figures["velocity_m_s"]["p50"] > 0.3
    figures = compare(samples(small), stamps(N), stamps(N), T, scale=1 / 0.9)
    assert figures is not None and figures["span_percent"] < 1e-6
    assert figures["velocity_m_s"]["p50"] < 1e-9


def test_the_claimed_sigma_is_that_of_both_poses_and_of_the_scale() -> None:
    T = curve(N)
    given = [replace(s, covariance=1e-4 * np.eye(6)) for s in samples(T)]
    figures = compare(given, stamps(N), stamps(N), T)
    steps = np.linalg.norm(T[10:, :3, 3] - T[:-10, :3, 3], axis=1)
    # two positions of three axes each, the first turn's lever of two axes, and the scale
    expected = np.sqrt(6e-4 + 2e-4 * steps**2 + (0.01 * steps) ** 2)
    assert figures is not None
    assert figures["span_sigma_m"] == pytest.approx(np.median(expected), rel=1e-3)
    assert figures["velocity_sigma_m_s"] == pytest.approx(np.sqrt(3), rel=0.01)


def test_poses_that_are_not_metric_are_not_compared() -> None:
    T = curve(N)
    given = samples(T)
    for i in range(30):
        given[i] = replace(given[i], status=PoseStatus.UNSCALED, T_w_c=7 * given[i].T_w_c)
    figures = compare(given, stamps(N), stamps(N), T)
    assert figures is not None
    assert figures["first_s"] == pytest.approx(30 * STEP_NS / 1e9)
    assert figures["span_m"]["max"] < 1e-9


def test_a_drifting_heading_shows_in_degrees_per_second() -> None:
    T = curve(N)
    turned = T.copy()
    drift = np.radians(0.05) * np.arange(N)[:, None] * np.array([0.0, 1.0, 0.0])
    turned[:, :3, :3] = T[:, :3, :3] @ se3.so3_exp(drift)
    figures = compare(samples(turned), stamps(N), stamps(N), T)
    assert figures is not None and figures["span_deg"]["p50"] == pytest.approx(0.5, rel=0.05)


def test_lost_frames_count_as_first_s_before_the_first_pose_and_as_a_gap_after() -> None:
    T = curve(N)
    late = compare(samples(T, range(0, 20)), stamps(N), stamps(N), T)
    assert late is not None
    assert late["first_s"] == pytest.approx(2.0) and late["live_percent"] == 100
    cut = compare(samples(T, range(30, 50)), stamps(N), stamps(N), T)
    assert cut is not None
    assert cut["live_percent"] == 75 and cut["longest_gap_s"] == pytest.approx(2.1)
    ends = compare(samples(T, range(60, N)), stamps(N), stamps(N), T)
    assert ends is not None and ends["longest_gap_s"] == pytest.approx(2.0)


def test_spans_do_not_cross_a_jump() -> None:
    T = curve(N)
    moved = T.copy()
    moved[40:] = se3.exp(np.array([30.0, 0, 0, 0, 0, 0])) @ moved[40:]
    figures = compare(samples(moved, epoch_from=40), stamps(N), stamps(N), T)
    assert figures is not None and figures["jumps"] == 1 and figures["span_m"]["max"] < 1e-9
    figures = compare(samples(moved), stamps(N), stamps(N), T)
    assert figures is not None and figures["span_m"]["max"] > 10
    i, j = spans(stamps(N), np.zeros(N, np.int64))
    assert len(i) == N - 10 and (j - i == 10).all()
    slow = stamps(N) * 107 // 100
    i, j = spans(slow, np.zeros(N, np.int64))
    assert len(i) == N - 10 and (j - i == 10).all()
    gap = np.delete(stamps(N), range(20, 40))
    i, j = spans(gap, np.zeros(len(gap), np.int64))
    assert (np.diff(gap[[i, j]], axis=0) == 1_000_000_000).all() and 15 not in i


def test_a_drive_never_live_and_one_without_poses() -> None:
    T = curve(N)
    figures = compare(samples(T, range(0, N)), stamps(N), stamps(N), T)
    assert figures == {"frames": N, "first_s": None}
    assert compare([], stamps(0), stamps(N), T) is None


def test_live_errors_of_a_drive_in_spacings_use_the_scale_of_the_alignment() -> None:
    T = curve(N)
    halved = T.copy()
    halved[:, :3, 3] *= 0.5
    estimate = Estimate("here", stamps(N), halved, live=tuple(samples(halved)))
    figures = results.compare(estimate, Truth(stamps(N), T))["live"]
    assert figures["span_percent"] < 1e-6
    given = replace(estimate, spacing_m=0.5)
    assert results.compare(given, Truth(stamps(N), T))["live"]["span_percent"] > 40
