from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calm_edge.geometry import se3
from calm_edge.pose_output.jump import jumped
from calm_edge.types import PoseSample, PoseStatus

TWIST = np.array([0.3, 0.1, 20.0, 0.02, 0.6, 0.01])
AT = se3.exp(np.array([4.0, 1, 50, 0.1, 0.4, 0.2]))


def after(seconds: float, off: np.ndarray | None = None) -> tuple[PoseSample, PoseSample]:
    """A sample, and one `seconds` later that deviates by twist `off` (6,) from its motion."""
    first = PoseSample(
        5_000_000_000, AT, TWIST[:3], np.eye(6), 0, PoseStatus.LIVE, turn_rate_c=TWIST[3:]
    )
    T = AT @ se3.compose(se3.so3_exp(TWIST[3:] * seconds), TWIST[:3] * seconds)
    if off is not None:
        T = T @ se3.exp(off)
    return first, replace(first, t_ns=first.t_ns + round(seconds * 1e9), T_w_c=T)


@pytest.mark.parametrize("seconds", [1 / 30, 0.1, 0.3])
def test_constant_velocity_and_hard_braking_are_no_jump(seconds: float) -> None:
    assert not jumped(*after(seconds))
    # full braking, and the pitch that goes with it
    braking = np.array([0, 0, -10 * seconds**2 / 2, 3 * seconds**2 / 2, 0, 0])
    assert not jumped(*after(seconds, braking))


@pytest.mark.parametrize("off", [[1.0, 0, 0, 0, 0, 0], [0, 0, 0, 0, 0.2, 0]])
def test_a_metre_aside_or_a_sudden_turn_is_a_jump(off: list[float]) -> None:
    assert jumped(*after(0.1, np.array(off)))
    # within a second a car can get there
    assert not jumped(*after(1.0, np.array(off)))


def test_without_a_velocity_there_is_no_jump() -> None:
    first, second = after(0.1, np.array([9.0, 0, 0, 0, 0, 0]))
    assert not jumped(replace(first, velocity_c=np.full(3, np.nan)), second)
