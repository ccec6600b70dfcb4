"""Errors along the path of the live pose, added up."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calm_edge.frontend.drift import POINTS_ALIKE, Drift
from calm_edge.frontend.submap_errors import SubmapErrors
from calm_edge.geometry import se3
from calm_edge.types import Float

NONE = SubmapErrors(0.0, 0.0, np.zeros((6, 6)))
NO_NOISE = np.zeros((6, 6))


def driven(T: Float, errors: SubmapErrors, noise: Float = NO_NOISE, replaced: float = 0.0) -> Drift:
    drift = Drift()
    for pose in T:
        drift.move(pose, errors, noise, replaced)
    return drift


def turning(n: int) -> Float:
    """Poses (n, 4, 4) of a car that turns by 2 degrees a metre."""
    step = se3.exp(np.array([0, 0, 1.0, 0, np.radians(2.0), 0]))
    return np.stack([np.linalg.matrix_power(step, k) for k in range(n)])


def test_the_scale_counts_with_its_sigma_and_in_the_axes_of_the_camera() -> None:
    turned = se3.so3_exp(np.array([0.0, np.pi / 2, 0.0]))
    start, middle, end = (se3.compose(turned, np.array([0.0, 0.0, z])) for z in (5.0, 15.0, 25.0))
    drift = driven(np.stack([start, middle]), replace(NONE, scale_log_sigma=0.01))
    np.testing.assert_allclose(turned @ drift.scale_offset, [0, 0, 0.1], atol=1e-12)
    drift.move(end, replace(NONE, scale_log_sigma=0.02), NO_NOISE, 0.0)
    np.testing.assert_allclose(turned @ drift.scale_offset, [0, 0, 0.3], atol=1e-12)
    drift.move(start, replace(NONE, scale_log_sigma=0.015), NO_NOISE, 0.0)
    np.testing.assert_allclose(drift.scale_offset, 0, atol=1e-12)


def test_a_wrong_focal_bends_the_path_as_its_offset_says() -> None:
    sigma = 0.01
    true = turning(30)
    step = se3.inverse(true[0]) @ true[1]
    step[:3, :3] = se3.so3_exp(np.array([0, (1 - sigma) * np.radians(2.0), 0]))
    bent = np.stack([np.linalg.matrix_power(step, k) for k in range(30)])
    drift = driven(true, replace(NONE, focal_log_sigma=sigma))
    np.testing.assert_allclose(
        drift.focal_offset, se3.log(se3.inverse(true[-1]) @ bent[-1]), atol=2e-3
    )


@pytest.mark.parametrize("replaced", [0.0, 0.1])
def test_independent_errors_of_the_steps_add_up_to_the_covariance(replaced: float) -> None:
    """10,000 drives, each step with an error drawn from what the step adds."""
    true = turning(20)
    by_length, noise = np.diag([4e-6] * 3 + [1e-8] * 3), np.diag([1e-6] * 3 + [4e-8] * 3)
    drift = driven(true, replace(NONE, by_length=by_length), noise, replaced)
    step = se3.inverse(true[0]) @ true[1]
    added = np.linalg.norm(step[:3, 3]) * by_length + POINTS_ALIKE * replaced * noise
    rng = np.random.default_rng(3)
    T = np.broadcast_to(np.eye(4), (10_000, 4, 4))
    for _ in range(19):
        T = T @ step @ se3.exp(rng.normal(size=(len(T), 6)) * np.sqrt(np.diag(added)))
    error = se3.log(se3.inverse(true[-1]) @ T)
    nees = np.einsum("ni,ij,nj->n", error, np.linalg.inv(drift.covariance), error)
    assert abs(nees.mean() / 6 - 1) < 0.05


def test_after_a_restart_the_next_pose_is_the_first() -> None:
    unsure = SubmapErrors(0.02, 0.01, np.eye(6))
    drift = driven(turning(5), unsure, np.eye(6), 0.5)
    drift.restart()
    drift.move(turning(9)[-1], unsure, np.eye(6), 0.5)
    for value in (drift.covariance, drift.scale_offset, drift.focal_offset):
        assert not value.any()
