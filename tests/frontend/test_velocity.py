"""The velocity at the end of the window, and its covariance."""

from __future__ import annotations

import numpy as np
import pytest

from calm_edge.frontend.velocity import RecentPath, twist_now
from calm_edge.geometry import se3
from calm_edge.types import Float

T_NS = np.arange(5) * 100_000_000
SURE = np.broadcast_to(np.diag([1e-4] * 3 + [1e-6] * 3), (5, 6, 6))


def braking_turn() -> tuple[Float, Float]:
    """Poses (5, 4, 4) and the twist (6,) at the last one."""
    t = T_NS / 1e9
    heading = 0.5 * t
    speed = 10 - 4 * t
    position = np.stack([5 + 0 * t, 1 + 0 * t, 10 * t - 2 * t**2 - 3], -1)
    T = se3.compose(se3.so3_exp(np.stack([0 * t, heading, 0 * t], -1)), position)
    return T, np.array([*(T[-1, :3, :3].T @ [0, 0, speed[-1]]), 0, 0.5, 0])


def test_in_a_braking_turn_the_twist_is_that_at_the_end() -> None:
    T, expected = braking_turn()
    np.testing.assert_allclose(twist_now(T_NS, T, SURE)[0], expected, atol=1e-9)


def test_two_poses_give_their_difference_and_one_gives_none() -> None:
    T = np.stack(
        [np.eye(4), se3.compose(se3.so3_exp(np.array([0, 0.1, 0])), np.array([0, 0, 0.8]))]
    )
    twist, covariance = twist_now(T_NS[:2], T, SURE[:2])
    R = T[1, :3, :3]
    np.testing.assert_allclose(twist, [*(R.T @ [0, 0, 8.0]), 0, 1.0, 0], atol=1e-9)
    # two poses do not determine the motion in between
    assert np.isnan(covariance).any()
    assert all(np.isnan(part).all() for part in twist_now(T_NS[:1], T[:1], SURE[:1]))


def test_at_standstill_the_velocity_is_zero() -> None:
    T = np.broadcast_to(se3.exp(np.array([3.0, 1, 2, 0.1, 0.2, 0.3])), (5, 4, 4))
    np.testing.assert_allclose(twist_now(T_NS, T, SURE)[0], 0, atol=1e-9)


def test_an_unknown_pose_covariance_makes_that_of_the_twist_unknown() -> None:
    T, expected = braking_turn()
    unsure = SURE.copy()
    unsure[2] = np.nan
    twist, covariance = twist_now(T_NS, T, unsure)
    np.testing.assert_allclose(twist, expected, atol=1e-9)
    assert np.isnan(covariance).any()


def test_the_covariance_matches_noisy_poses() -> None:
    T, _ = braking_turn()
    random = np.random.default_rng(5)
    A = random.normal(size=(5, 6, 6)) * np.array([0.01] * 3 + [0.003] * 3)[:, None]
    covariance = A @ np.swapaxes(A, -1, -2)
    twist, claimed = twist_now(T_NS, T, covariance)
    noise = np.einsum("nij,snj->sni", A, random.normal(size=(4000, 5, 6)))
    moves = T[None] @ se3.compose(se3.so3_exp(noise[..., 3:]), noise[..., :3])
    error = np.array([twist_now(T_NS, noisy, covariance)[0] - twist for noisy in moves])
    nees = np.einsum("si,ij,sj->s", error, np.linalg.inv(claimed), error)
    # 6 degrees of freedom; the mean of 4000 has a sigma of 0.055
    assert abs(nees.mean() - 6) < 0.3
    np.testing.assert_allclose(np.diag(np.cov(error.T)) / np.diag(claimed), 1, atol=0.1)


def test_vibration_about_the_parabola_increases_the_covariance() -> None:
    t_ns = np.arange(13) * 33_000_000
    shake = np.random.default_rng(3).normal(size=13) * 0.02
    still = np.zeros(13)
    T = se3.compose(
        se3.so3_exp(np.stack([shake, still, still], -1)), np.stack([still, still, still], -1)
    )
    sure = np.broadcast_to(SURE[0], (13, 6, 6))
    calm = twist_now(t_ns, np.broadcast_to(np.eye(4), T.shape), sure)[1]
    twist, shaken = twist_now(t_ns, T, sure)
    # errors of many sigmas of the calm case are few of its own
    assert abs(twist[3]) > 3 * np.sqrt(calm[3, 3])
    assert abs(twist[3]) < 3 * np.sqrt(shaken[3, 3])
    # only the axes that vibrate
    np.testing.assert_allclose(shaken[:3, :3], calm[:3, :3], atol=1e-12)


@pytest.mark.parametrize("hz", [10, 30])
def test_a_body_that_sways_has_an_error_of_its_sigma(hz: int) -> None:
    """On a bad road the slope of the parabola is wrong by what the residuals show."""
    n, t_ns = round(0.4 * hz) + 1, np.arange(60 * hz) * (1_000_000_000 // hz)
    t = t_ns * 1e-9
    rng = np.random.default_rng(7)
    amplitude, phase = rng.normal(size=(2, 20, 1)) * np.array([[[0.05]], [[10.0]]])
    rate = 2 * np.pi * np.linspace(0.4, 1.6, 20)[:, None]
    height = (amplitude * np.sin(rate * t + phase)).sum(0)
    climbs = (amplitude * rate * np.cos(rate * t + phase)).sum(0)
    T = np.tile(np.eye(4), (len(t), 1, 1))
    T[:, 1, 3] = height
    sure = np.broadcast_to(1e-12 * np.eye(6), (n, 6, 6))
    ratio = []
    for end in range(n, len(t), n // 2):
        rows = slice(end - n, end)
        twist, covariance = twist_now(t_ns[rows], T[rows], sure)
        ratio.append((twist[1] - climbs[end - 1]) / np.sqrt(covariance[1, 1]))
    assert 0.7 < np.sqrt(np.mean(np.square(ratio))) < 1.3


def test_a_path_is_extrapolated_and_drops_old_poses() -> None:
    T, expected = braking_turn()
    path = RecentPath()
    assert not path and path.predict(0) is None
    path.add(0, T[0], SURE[0])
    np.testing.assert_array_equal(path.predict(50_000_000), T[0])
    # poses before the window are not used: they would bend the parabola
    for k in range(1, 5):
        path.add(int(T_NS[k]) - int(T_NS[1]) + 2_000_000_000, T[k], SURE[k])
    path.add(int(T_NS[4]) - int(T_NS[1]) + 2_100_000_000, T[4] @ se3.inverse(T[3]) @ T[4], SURE[4])
    assert path.newest_ns == 2_400_000_000
    there = path.predict(2_500_000_000)
    assert there is not None
    np.testing.assert_allclose(se3.inverse(path.newest) @ there, se3.inverse(T[4]) @ path.newest)
    assert np.linalg.norm(path.twist()[0][:3] - expected[:3]) < 1.5
    path.clear()
    assert not path


def test_poses_without_a_stamp_of_their_own_have_no_say() -> None:
    T, expected = braking_turn()
    path = RecentPath()
    for k in range(5):
        path.add(int(T_NS[k]), T[k], SURE[k])
        if k == 2:
            # a repeated stamp in between, replaced by one that is a long way off
            path.add(int(T_NS[k]) + 1_000_000, T[k + 1], SURE[k], own_stamp=False)
            assert np.isnan(path.twist()[0]).all() and np.isnan(path.twist()[1]).all()
            np.testing.assert_array_equal(path.newest, T[k + 1])
    np.testing.assert_allclose(path.twist()[0], expected, atol=1e-9)
    assert np.isfinite(path.twist()[1]).all()


def moved(*z_at_ms: tuple[float, float], own: bool = True) -> RecentPath:
    """A path straight ahead: (z [m], t [ms]) of each pose."""
    path = RecentPath()
    for z, t_ms in z_at_ms:
        path.add(round(t_ms * 1e6), at(z), SURE[0], own_stamp=own)
    return path


def at(z: float) -> Float:
    return se3.compose(np.eye(3), np.array([0.0, 0.0, z]))


@pytest.mark.parametrize(
    ("z", "t_ms", "jumps"),
    [
        (2.6, 200, False),
        (2.5, 200, False),  # braking by 10 m/s^2
        (1.3 + 0.3, 200, True),  # tracks that jumped back by a period of a barrier
        (1.3 + 4.0, 200, True),
        (0.0, 200, True),
        (1.3 + 3.9, 400, False),  # two frames were dropped
        (2.6, 120, False),  # a stamp that is 80 ms too early
    ],
)
def test_a_jump_is_a_step_that_no_car_makes(z: float, t_ms: float, jumps: bool) -> None:
    """13 m/s so far."""
    assert moved((0.0, 0), (1.3, 100)).jumps(round(t_ms * 1e6), at(z)) is jumps


def test_noise_at_standstill_and_a_start_are_no_jumps() -> None:
    assert not moved((0.0, 0), (0.05, 100)).jumps(200_000_000, at(-0.1))
    assert not moved((0.0, 0)).jumps(100_000_000, at(1.3))
    assert not moved((0.0, 0), (1.3, 100), own=False).jumps(200_000_000, at(1.3))
