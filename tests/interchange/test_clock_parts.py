"""Gaps between the parts of a split video, found by the other camera."""

from __future__ import annotations

import numpy as np
import pytest

from calm_edge.interchange.clock_parts import find_gaps, increasing, shifted, with_stamps
from calm_edge.interchange.clocks import relate
from calm_edge.interchange.turns import Turns
from device.frame import Eye
from tests.interchange.turning import drive


def in_parts(turns: Turns, gap_s: float) -> tuple[Turns, float, float]:
    """Turns of a recorder that loses gap_s in the middle, and begins the new part one step later.

    Returns the turns, the new part's first stamp, and the time that its stamps lack.
    """
    t, half = turns.t_s, len(turns.t_s) // 2
    new = int(np.searchsorted(t, t[half] + gap_s))
    keep = np.r_[: half + 1, new : len(t)]
    lacking = float(t[new] - t[half] - 0.033)
    rows = keep[1:] - 1
    own = t[keep] - np.where(keep >= new, lacking, 0.0)
    # the turn during the gap was measured from picture to picture, if at all
    sigma = np.where(keep[1:] == new, np.inf, turns.sigma[rows])
    return Turns(own, turns.step[rows], turns.zoom[rows], sigma), float(own[half + 1]), lacking


@pytest.mark.parametrize("eye", list(Eye))
@pytest.mark.parametrize("gap_s", [1.2, 0.15])
def test_a_gap_is_found_and_closed(eye: Eye, gap_s: float) -> None:
    primary, assistant, true_s = drive(90, 5)
    turns = [primary, assistant]
    turns[eye], join, lacking = in_parts(turns[eye], gap_s)
    joins = ([join], []) if eye is Eye.PRIMARY else ([], [join])
    (gap,) = find_gaps(turns[0], turns[1], joins)
    assert gap.eye is eye and abs(gap.gap_s - lacking) < 4 * gap.sigma_s < 0.06
    assert f"{eye.name.lower()}: " in gap.line() and "passed before the part at" in gap.line()
    closed = [with_stamps(t, shifted(t.t_s, [gap], e)) for t, e in zip(turns, Eye, strict=True)]
    fit = relate(closed[0], closed[1], None).fit
    assert abs(fit.primary_time(assistant.t_s) - true_s).max() < 0.02


def test_several_gaps_of_a_long_drive() -> None:
    """A recorder that loses 0.8 s every two minutes: no offset fits more than one part."""
    primary, assistant, true_s = drive(360, 7)
    late = 0.8 * (primary.t_s > 120) + 0.8 * (primary.t_s > 240)
    keep = (primary.t_s < 120) | (primary.t_s > 120.8) & (primary.t_s < 240) | (primary.t_s > 240.8)
    rows = np.flatnonzero(keep)
    sigma = np.where(np.diff(rows) == 1, primary.sigma[rows[1:] - 1], np.inf)
    own = (primary.t_s - late)[rows]
    steps = primary.step[rows[1:] - 1]
    split = Turns(own, steps, np.zeros(len(steps)), sigma)
    gaps = find_gaps(split, assistant, ([120.0, 239.2], []))
    assert [g.eye for g in gaps] == [Eye.PRIMARY] * 2
    assert all(abs(g.gap_s - 0.8) < 0.03 for g in gaps)
    fit = relate(with_stamps(split, shifted(own, gaps, Eye.PRIMARY)), assistant, None).fit
    assert abs(fit.primary_time(assistant.t_s) - true_s).max() < 0.03


def test_without_a_gap_nothing_is_changed() -> None:
    primary, assistant, _ = drive(90, 6)
    assert find_gaps(primary, assistant, ([40.0], [30.0, 60.0])) == []
    assert find_gaps(primary, assistant, ([], [])) == []


def test_what_was_filmed_twice_is_kept_once() -> None:
    t = np.array([0.0, 1, 2, 1.5, 2.5, 3])
    assert increasing(t).tolist() == [True, True, True, False, True, True]
    turns = Turns(t, np.arange(15.0).reshape(5, 3), np.zeros(5), np.ones(5))
    found = with_stamps(turns, t)
    assert found.t_s.tolist() == [0, 1, 2, 2.5, 3]
    assert found.sigma.tolist() == [1, 1, np.inf, 1] and found.step[3].tolist() == [12, 13, 14]
