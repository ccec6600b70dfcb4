"""Loops on Sim(3) and SL(4): independent of the unit; failures have a reason."""

import numpy as np
import pytest

from bench.baselines import pose_graph
from bench.baselines.overlap import BaselineError
from bench.baselines.pose_graph import Tie
from calm_edge.geometry import se3
from tests.drives import circle

BOTH = pytest.mark.parametrize("group", ["sim3", "sl4"])
RING = circle(24, radius=30.0)


def ties(length: float, drift: float) -> tuple[np.ndarray, list[Tie]]:
    """Chained transforms (24, 4, 4) and the ties, every one too large by `drift`."""
    unit, T_w_s, out = np.diag([length] * 3 + [1.0]), [np.eye(4)], []
    for k in range(1, len(RING)):
        T = se3.inverse(RING[k - 1]) @ RING[k] @ np.diag([drift] * 3 + [1.0])
        out.append(Tie(k - 1, k, unit @ T @ np.linalg.inv(unit)))
        T_w_s.append(T_w_s[-1] @ out[-1].T_previous_new)
    return np.array(T_w_s), out


def centres(T_w_s: np.ndarray) -> np.ndarray:
    return T_w_s[:, :3, 3] / T_w_s[:, 3:, 3]


def loop(length: float) -> Tie:
    unit = np.diag([length] * 3 + [1.0])
    T = unit @ se3.inverse(RING[0]) @ RING[-1] @ np.linalg.inv(unit)
    return Tie(0, len(RING) - 1, T)


@BOTH
def test_the_unit_changes_nothing(group: str) -> None:
    found = []
    for length in (1.0, 1000.0):
        T_w_s, chain = ties(length, 1.02)
        found.append(pose_graph.optimise(group, T_w_s, chain, [loop(length)]))
    gap = centres(found[1]) / 1000 - centres(found[0])
    assert np.abs(gap).max() < 1e-3 * 30
    open_end, closed_end = (
        np.linalg.norm(centres(T)[-1] - RING[-1, :3, 3]) for T in (ties(1.0, 1.02)[0], found[0])
    )
    assert closed_end < open_end / 5


@BOTH
def test_the_first_stays_wherever_it_is(group: str) -> None:
    T_w_s, chain = ties(1.0, 1.02)
    first = se3.exp(np.array([3.0, -1.0, 8.0, 0.2, 1.0, -0.3])) @ np.diag([2.5, 2.5, 2.5, 1.0])
    found = pose_graph.optimise(group, T_w_s, chain, [loop(1.0)])
    elsewhere = pose_graph.optimise(group, first @ T_w_s, chain, [loop(1.0)])
    assert np.allclose(elsewhere[0], first, atol=1e-6)
    expected = np.linalg.norm(centres(first @ found) - centres(elsewhere), axis=1)
    assert expected.max() < 1e-3


@BOTH
def test_broken_measurements_are_a_reason(group: str) -> None:
    T_w_s, chain = ties(1.0, 1.0)
    broken = Tie(0, 5, np.diag([1.0, 1.0, -1.0, 1.0]))
    nothing = Tie(0, 5, np.full((4, 4), np.nan))
    for tie in (broken, nothing):
        with pytest.raises(BaselineError):
            pose_graph.optimise(group, T_w_s, chain, [tie])
