"""The velocity of now, not of half a window ago."""

from __future__ import annotations

import numpy as np

from calm_edge.frontend.velocity import velocity_now
from calm_edge.geometry import se3

T_NS = np.arange(5) * 100_000_000


def test_a_braking_turn_is_told_as_it_is_at_its_end() -> None:
    t = T_NS / 1e9
    heading = 0.5 * t
    speed = 10 - 4 * t
    path = 10 * t - 2 * t**2
    position = np.stack([5 + 0 * t, 1 + 0 * t, path - 3], -1)
    T = se3.compose(se3.so3_exp(np.stack([0 * t, heading, 0 * t], -1)), position)
    expected = T[-1, :3, :3].T @ [0, 0, speed[-1]]
    np.testing.assert_allclose(velocity_now(T_NS, T), expected, atol=1e-9)


def test_two_poses_give_their_difference_and_one_gives_none() -> None:
    T = np.stack([np.eye(4), se3.exp(np.array([0.0, 0.0, 0.8, 0, 0, 0]))])
    np.testing.assert_allclose(velocity_now(T_NS[:2], T), [0, 0, 8], atol=1e-9)
    assert np.isnan(velocity_now(T_NS[:1], T[:1])).all()


def test_standing_still_is_no_velocity() -> None:
    T = np.broadcast_to(se3.exp(np.array([3.0, 1, 2, 0.1, 0.2, 0.3])), (5, 4, 4))
    np.testing.assert_allclose(velocity_now(T_NS, T), 0, atol=1e-9)
