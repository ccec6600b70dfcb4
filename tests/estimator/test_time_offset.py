import dataclasses

import numpy as np
import pytest

from calm_edge.estimator import time_offset
from calm_edge.estimator.time_offset import TimeOffsetEstimator
from calm_edge.geometry import se3
from calm_edge.geometry.camera import Perspective
from calm_edge.types import Submap

PERIOD_S = 0.1
T_P_A = se3.exp(np.array([0.55, 0.03, 0.05, 0.02, 0.07, -0.01]))


def path(n, speed, yaw):
    """T_w_p (n, 4, 4) at 10 Hz: speed [m/s] and yaw rate [rad/s] of each step."""
    T = [np.eye(4)]
    for v, w in zip(speed, yaw, strict=True):
        T.append(T[-1] @ se3.exp(np.array([0, 0, v, 0, w, 0]) * PERIOD_S))
    return np.array(T)


def submaps(T_w_p, late_s, *, noise=0.0, seed=0, n=15):
    """Sub-maps of 15 + 15 views in units of their own; both cameras have equal stamps."""
    rng = np.random.default_rng(seed)
    t = PERIOD_S * np.arange(len(T_w_p))
    T_w_a = se3.interpolate_at(t, T_w_p, t + late_s) @ T_P_A
    out = []
    for start in range(0, len(T_w_p) - n, n - 3):
        cut = slice(start, start + n)
        T = se3.inverse(T_w_p[start]) @ np.concatenate([T_w_p[cut], T_w_a[cut]])
        T = T @ se3.exp(noise * rng.standard_normal((2 * n, 6)) * [1, 1, 1, 0.1, 0.1, 0.1])
        T[:, :3, 3] *= rng.uniform(0.5, 2.0)
        stamps = (np.tile(t[cut], 2) * 1e9).astype(np.int64)
        cameras = (Perspective(500.0, 500.0, 319.5, 119.5, 640, 240),) * (2 * n)
        ids = tuple(range(start, start + n))
        out.append(
            Submap(
                len(out),
                ids,
                ids,
                3,
                stamps,
                T,
                cameras,
                T,
                cameras,
                1.0,
                np.eye(4),
                np.full(2, np.inf),
            )
        )
    return out


def lively(n, seed=0):
    """A drive in a town with varying speed and yaw rate."""
    k = np.arange(n - 1) * PERIOD_S
    rng = np.random.default_rng(seed)
    a, b = rng.uniform(0, 6, 2)
    return path(n, 9 + 4 * np.sin(k / 3 + a), 0.25 * np.maximum(np.sin(k / 5 + b) - 0.3, 0))


def found(maps):
    clock = TimeOffsetEstimator()
    for submap in maps:
        clock.add(submap)
    return clock.offset


@pytest.mark.parametrize("late_s", [-0.04, 0.0, 0.025])
def test_exact_poses_give_the_offset(late_s):
    offset = found(submaps(lively(200), late_s))
    # the rest is due to interpolation between frames and to the prior
    assert offset.offset_s == pytest.approx(late_s, abs=0.0015)
    assert offset.observed == (late_s != 0)


def test_the_normalised_error_is_at_most_one_under_noise():
    errors = []
    for seed in range(30):
        offset = found(submaps(lively(150, seed), 0.015, noise=0.01, seed=seed))
        errors.append((offset.offset_s - 0.015) / offset.sigma_s)
    # these drives have no systematic error, which the sigma includes
    assert np.sqrt(np.mean(np.square(errors))) < 1.0


def test_constant_velocity_on_a_straight_is_unobserved():
    straight = path(200, np.full(199, 10.0), np.zeros(199))
    offset = found(submaps(straight, 0.03, noise=0.005))
    assert not offset.observed


def test_too_few_submaps_give_the_prior():
    maps = submaps(lively(200), 0.02)[: time_offset.MIN_SUBMAPS - 1]
    assert found(maps) == time_offset.TimeOffset(0.0, time_offset.PRIOR_SIGMA_S)


def test_a_submap_of_one_camera_is_ignored():
    maps = submaps(lively(200), 0.02)
    blind = [dataclasses.replace(m, assistant_ids=(), T_s_c=m.T_s_c[:15]) for m in maps]
    assert found(blind) == time_offset.TimeOffset(0.0, time_offset.PRIOR_SIGMA_S)


def test_only_the_newest_submaps_are_used(monkeypatch):
    monkeypatch.setattr(time_offset, "MAX_SUBMAPS", 6)
    maps = submaps(lively(400), 0.02)
    assert found(maps) == found(maps[-6:])
