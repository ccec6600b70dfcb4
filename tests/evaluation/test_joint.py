"""Error of drives in one frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calm_edge.evaluation import EvaluationError
from calm_edge.evaluation.estimate import Estimate
from calm_edge.evaluation.joint import joint_error
from calm_edge.evaluation.truth import Truth
from calm_edge.geometry import se3
from calm_edge.types import Float, Metre
from tests.evaluation.worlds import curve, stamps

N = 200
# of the map's frame in that of the truth
T_t_w = se3.exp(np.array([2.0, 1, -3, 0.3, -0.2, 0.5]))


def drive(first: int, last: int, off: Float | None = None) -> tuple[Estimate, Truth]:
    """Frames [first, last) of a path; off: (3,) by which the map has this drive moved."""
    true = T_t_w @ curve(N)[first:last]
    T = curve(N)[first:last].copy()
    T[:, :3, 3] += np.zeros(3) if off is None else off
    t_ns = stamps(N)[first:last]
    return Estimate("map", t_ns, T, spacing_m=0.5, metre=Metre(0.01)), Truth(t_ns, true)


def test_two_drives_that_lie_rightly_to_each_other_have_no_error() -> None:
    error = joint_error([drive(0, 120), drive(80, N)])
    assert error.alignment == "se3"
    assert max(error.ate_m, *error.by_drive) < 1e-9


def test_a_drive_that_is_moved_against_the_other_is_an_error_of_both() -> None:
    off = np.array([0.0, 2.0, 0.0])
    alone = joint_error([drive(80, N, off)])
    assert alone.ate_m < 1e-9
    error = joint_error([drive(0, 120), drive(80, N, off)])
    assert 0.2 < error.ate_m < 2 and min(error.by_drive) > 0.1
    squares = 120 * np.square(error.by_drive).sum()
    assert error.ate_m == pytest.approx(np.sqrt(squares / 240))


def test_lengths_that_are_not_metric_are_scaled_together() -> None:
    found = []
    for estimate, truth in (drive(0, 120), drive(80, N)):
        T = estimate.T_w_c.copy()
        T[:, :3, 3] *= 3
        found.append((replace(estimate, T_w_c=T, spacing_m=None, metre=None), truth))
    error = joint_error(found)
    assert error.alignment == "sim3" and error.ate_m < 1e-9


def test_truths_without_a_common_frame_and_drives_without_truth_are_refused() -> None:
    pairs = [drive(0, 120), drive(80, N)]
    own = [
        (estimate, replace(truth, T_w_c=se3.inverse(truth.T_w_c[0]) @ truth.T_w_c))
        for estimate, truth in pairs
    ]
    with pytest.raises(EvaluationError, match="each in a frame of its own"):
        joint_error(own)
    # one of them may begin at the origin: its frame can be that of all
    T_0 = se3.inverse(pairs[0][1].T_w_c[0])
    moved = replace(pairs[1][1], T_w_c=T_0 @ pairs[1][1].T_w_c)
    assert joint_error([own[0], (pairs[1][0], moved)]).ate_m < 1e-9
    with pytest.raises(EvaluationError, match="has no true poses at its times"):
        joint_error([pairs[0], (pairs[1][0], replace(pairs[1][1], t_ns=pairs[1][1].t_ns + 10**12))])
