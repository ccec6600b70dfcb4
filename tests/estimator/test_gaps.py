"""Gaps of the path: where nothing connects two keyframes, and how far the rest is then off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench.scripted.errors import ScriptedErrors
from calm_edge.estimator import gaps
from calm_edge.estimator.localizer import Localizer
from calm_edge.types import Landmarks, LoopClosure, Submap
from tests.correction.submaps import submap as flat
from tests.estimator.test_localizer import METRES, Failing, scene, straight, windows

N = 6


def submap(first: int = 0, **changes: object) -> Submap:
    """N keyframes of both cameras, at 10 Hz and 0.8 m from one to the next."""
    T = np.tile(np.eye(4), (2 * N, 1, 1))
    T[:, 2, 3] = 0.8 * np.tile(np.arange(N), 2)
    stamps = np.tile((first + np.arange(N)) * 100_000_000, 2)
    each = replace(flat(0, (300.0, 300.0), N).without_loop(), T_s_c=T, t_ns=stamps)
    return replace(each, primary_ids=tuple(range(first, first + N)), **changes)


def landmarks(*tracks: tuple[int, ...]) -> Landmarks:
    """Landmarks, each seen by the given views."""
    index = np.repeat(np.arange(len(tracks)), [len(track) for track in tracks])
    view = np.concatenate([np.array(track, np.int64) for track in tracks])
    return Landmarks(np.zeros((len(tracks), 3)), index, view, np.zeros((len(view), 2), np.float32))


def test_a_cut_is_where_hardly_a_landmark_passes() -> None:
    left, right = (0, 1, 2), (3, 4, 5)
    # the last two are wrong matches; views from N on are of the assistant
    marks = landmarks(*[left] * 9, *[right] * 9, (2, 2 + N), (2, 3), (1, 4 + N))
    assert gaps.cuts(submap(), marks) == (3,)
    assert gaps.cuts(submap(), landmarks(*[left] * 9, *[right] * 9, *[(2, 3 + N)] * 5)) == ()
    assert gaps.cuts(submap(), None) == ()
    # of many features a few wrong matches pass more often
    many = [left] * 100, [right] * 100
    assert gaps.cuts(submap(), landmarks(*many[0], *many[1], *[(2, 3 + N)] * 9)) == (3,)
    assert gaps.cuts(submap(), landmarks(*many[0], *many[1], *[(2, 3 + N)] * 20)) == ()


def test_what_is_not_seen_grows_with_the_time_and_the_speed() -> None:
    seconds = (0.5, 1.0, 2.0, 8.0, 60.0)
    sigmas = np.array([gaps.uncertainty(s, 8.0, 3.0) for s in seconds])
    assert (np.diff(sigmas[:, 0]) > 0).all() and (np.diff(sigmas[:3, 1]) > 0).all()
    # a direction can be no worse than unknown
    assert sigmas[-1, 1] == pytest.approx(np.pi / np.sqrt(3))
    assert gaps.uncertainty(1.6, 20.0, 3.0)[0] > gaps.uncertainty(1.6, 5.0, 3.0)[0] > 3.0
    assert gaps.uncertainty(0.0, 20.0, 3.0) == (0.0, 0.0)


def test_cuts_and_bridges_are_gaps_until_a_loop_closes_them() -> None:
    first, second = submap(cuts=(4,)), submap(20, bridged_s=1.5)
    within, between = gaps.find([first, second], [], 3.0)
    assert (within.before_id, within.after_id, within.start_ns) == (3, 4, 300_000_000)
    assert within.seconds == pytest.approx(0.1)
    assert (between.before_id, between.after_id, between.seconds) == (5, 20, 1.5)
    assert between.sigma_translation > 10 * within.sigma_translation
    loop = LoopClosure(23, 4, np.eye(4))
    assert gaps.find([first, second], [loop], 3.0) == (within,)
    assert gaps.find([first, second], [loop, LoopClosure(22, 0, np.eye(4))], 3.0) == ()


def test_the_line_for_the_user_has_time_and_sigma() -> None:
    found = gaps.find([submap(), submap(20, bridged_s=1.6)], [], 3.0)
    line = gaps.described(found, -65_000_000_000, metric=True)
    assert "a gap at 1:05 (1.6 s in all)" in line and "constant velocity" in line
    assert "sigma 6.4 m and 46 degrees" in line
    assert "units" in gaps.described(found * 2, 0, metric=False)


@pytest.mark.parametrize("fails", [{1}, {2, 3}])
def test_windows_that_fail_leave_a_gap_as_long_as_they_are(fails: set[int]) -> None:
    localizer = Localizer(METRES, Failing(scene(straight(75)), ScriptedErrors(), fails=fails))
    updates = [localizer.process(window) for window in windows(75)]
    (gap,) = localizer.gaps
    before, after = updates[min(fails) - 1], updates[max(fails) + 1]
    assert before is not None and after is not None
    assert gap.before_id == before.submap.primary_ids[-1]
    assert gap.after_id == after.submap.primary_ids[0]
    assert gap.seconds == pytest.approx(
        (after.submap.t_ns[0] - before.submap.t_ns[before.submap.n_primary - 1]) * 1e-9
    )
    localizer.finish()
    assert localizer.gaps == (gap,)


def test_a_whole_drive_has_none() -> None:
    localizer = Localizer(METRES, Failing(scene(straight(40)), ScriptedErrors(), fails=set()))
    for window in windows(40):
        localizer.process(window)
    assert localizer.gaps == ()
