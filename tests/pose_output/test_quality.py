from __future__ import annotations

import numpy as np
import pytest

from calm_edge.pose_output.quality import FAILED, HALF_SIGMA_M, HALF_SIGMA_RAD, UNKNOWN, quality
from calm_edge.types import PoseStatus


def covariance(sigma_m: float, sigma_rad: float) -> np.ndarray:
    """Uncertain in one direction that is no axis."""
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
def test_the_worst_direction_rules(sigma_m: float, sigma_rad: float, expected: int) -> None:
    assert quality(covariance(sigma_m, sigma_rad), PoseStatus.LIVE) == expected


def test_the_estimator_behind_halves_it_and_never_to_nothing() -> None:
    assert quality(covariance(0.0, 0.0), PoseStatus.LAGGING) == 50
    assert quality(covariance(100.0, 1.0), PoseStatus.LAGGING) == 1


def test_unknown_and_failed_have_their_own_numbers() -> None:
    unknown = np.full((6, 6), np.nan)
    assert quality(unknown, PoseStatus.LIVE) == UNKNOWN == 0
    assert quality(np.eye(6), PoseStatus.LOST) == FAILED == -1
    assert quality(unknown, PoseStatus.LOST) == -1
