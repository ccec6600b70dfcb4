from __future__ import annotations

import numpy as np
import pytest

from calm_edge.pose_output.quality import (
    FAILED,
    HALF_SIGMA_M,
    HALF_SIGMA_RAD,
    HALF_SIGMA_SCALE,
    UNKNOWN,
    quality,
)
from calm_edge.types import PoseStatus


def covariance(sigma_m: float, sigma_rad: float) -> np.ndarray:
    """A covariance that is uncertain in one direction off the axes."""
    along = np.array([1.0, 2.0, -2.0]) / 3
    out = np.outer(along, along)
    return np.kron(np.diag([sigma_m**2, sigma_rad**2]), out)


@pytest.mark.parametrize(
    ("sigma_m", "sigma_rad", "expected"),
    [
        (0.0, 0.0, 100),
        (HALF_SIGMA_M, 0.0, 50),
        (0.0, HALF_SIGMA_RAD, 50),
        (HALF_SIGMA_M, HALF_SIGMA_RAD, 33),
        (0.005, 0.0, 99),
        (100.0, 1.0, 1),
    ],
)
def test_quality_is_that_of_the_most_uncertain_direction(
    sigma_m: float, sigma_rad: float, expected: int
) -> None:
    assert quality(covariance(sigma_m, sigma_rad), 0.0, PoseStatus.LIVE) == expected


def test_quality_while_lagging_is_halved_and_at_least_one() -> None:
    assert quality(covariance(0.0, 0.0), 0.0, PoseStatus.LAGGING) == 50
    assert quality(covariance(100.0, 1.0), 0.0, PoseStatus.LAGGING) == 1


def test_quality_of_unknown_covariance_and_of_a_lost_pose() -> None:
    unknown = np.full((6, 6), np.nan)
    assert quality(unknown, 0.0, PoseStatus.LIVE) == UNKNOWN == 0
    assert quality(np.eye(6), 0.0, PoseStatus.LOST) == FAILED == -1
    assert quality(unknown, 0.0, PoseStatus.LOST) == -1


def test_quality_falls_with_the_sigma_of_the_scale_and_is_failed_without_a_metre() -> None:
    exact = covariance(0.0, 0.0)
    assert quality(exact, HALF_SIGMA_SCALE, PoseStatus.LIVE) == 50
    assert quality(exact, np.inf, PoseStatus.UNSCALED) == FAILED
