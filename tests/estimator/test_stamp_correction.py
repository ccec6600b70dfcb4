import numpy as np
import pytest

from calm_edge.estimator.stamp_correction import FIRST_WINDOWS, StampCorrection
from calm_edge.types import Hints
from tests.estimator.test_late_stamps import straight, town, windows

START_NS = 5_000_000_000


def hints_of(views, n_loop=0):
    t = np.r_[views.t_p, views.t_a, np.zeros(n_loop)]
    eyes = np.r_[np.zeros(len(views.t_p)), np.ones(len(views.t_a)), np.zeros(n_loop)]
    return Hints(eyes.astype(np.int64), START_NS + np.round(t * 1e9).astype(np.int64))


def corrected(views, n_loop=0):
    """The correction after the windows, and which of them changed it."""
    correction, changed = StampCorrection(), []
    for k, each in enumerate(views):
        if correction.wanted(k):
            poses = np.concatenate([each.T_s_p, each.T_s_a])
            changed.append(correction.add(k, hints_of(each, n_loop), poses))
    return correction, changed


@pytest.mark.parametrize(("late_s", "text"), [(-0.4, "0.40 s late"), (0.2, "0.20 s early")])
def test_wrong_stamps_are_corrected_and_told(late_s, text):
    views = windows(town, late_s)
    correction, changed = corrected(views, n_loop=1)
    assert any(changed) and correction.objection is None
    # the first correction already is near
    assert correction.notice.startswith("the assistant's stamps are 0.")
    assert text.split()[-1] in correction.notice and correction.notice.endswith(": corrected")
    late = correction.late_s(hints_of(views[3], n_loop=1))
    assert not late[:15].any() and late[-1] == 0
    assert np.allclose(late[15:30], late_s, atol=0.015)
    assert 0 < correction.sigma_s < 0.02


def test_a_fast_clock_is_named():
    correction, _ = corrected(windows(town, -0.03, -0.01))
    assert "clock is " in correction.notice and correction.notice.endswith(" % fast: corrected")
    percent = float(correction.notice.split(" %")[0].split()[-1])
    assert percent == pytest.approx(1.0, abs=0.15)


def test_right_stamps_stay_as_they_are():
    for views in (windows(town, 0.0), windows(straight, 0.0), windows(straight, 0.3)):
        correction, changed = corrected(views)
        assert not any(changed) and correction.notice == "" and correction.objection is None
        assert correction.late_s(hints_of(views[0])) is None
        assert not correction.late_s_or_zero(hints_of(views[0])).any()


def test_an_offset_that_is_seen_but_not_exact_is_an_objection():
    def bend(t):
        return np.radians(1.5) * np.sin(2 * np.pi * t / 3.0)

    correction, objections = StampCorrection(), set()
    for k, each in enumerate(windows(bend, -0.4)):
        correction.add(k, hints_of(each), np.concatenate([each.T_s_p, each.T_s_a]))
        objections.add(correction.objection)
    assert "the assistant's stamps do not fit: about 0.4 s late" in objections


def test_a_window_counts_once():
    views = windows(town, 0.2)
    correction = StampCorrection()
    poses = np.concatenate([views[0].T_s_p, views[0].T_s_a])
    assert correction.wanted(0)
    correction.add(0, hints_of(views[0]), poses)
    assert not correction.wanted(0)
    assert not correction.add(0, hints_of(views[0]), poses)


def test_windows_are_examined_seldom_once_the_offset_is_known_or_after_many():
    views = windows(town, 0.0)
    correction, _ = corrected(views)
    assert [k for k in range(100, 108) if correction.wanted(k)] == [100, 104]
    straight_on, k = StampCorrection(), 0
    for each in windows(straight, 0.0, seconds=40.0):
        assert k >= FIRST_WINDOWS or straight_on.wanted(k)
        straight_on.add(k, hints_of(each), np.concatenate([each.T_s_p, each.T_s_a]))
        k += 1
    assert k > FIRST_WINDOWS
    assert [k for k in range(100, 108) if straight_on.wanted(k)] == [100, 104]
