import dataclasses

import numpy as np
import pytest

from calm_edge.estimator.kit_watch import MOST, KitWatch, Suspect
from calm_edge.kit import layout
from calm_edge.types import Hints, KitBelief, Prediction

HINTS = Hints(np.zeros(0, np.int64), np.zeros(0, np.int64))
TURNED = np.radians(2.0)


def evidence(*, turned=0.0, focal=0.0, sigma=0.004):
    mean = np.zeros(layout.SIZE)
    mean[layout.RIG_CENTRE] = (1.0, 0.0, 0.0)
    mean[layout.RIG_ROTATION.start + 1] = turned
    mean[layout.LOG_FOCAL] = focal
    return KitBelief(mean, np.eye(layout.SIZE) / sigma**2)


def prediction(kit):
    return Prediction((), np.zeros((0, 4, 4)), kit=kit)


def suspect(number, **changed):
    return Suspect(number, 10**9 * number, prediction(evidence(**changed)), HINTS)


def test_a_window_fits_unless_a_part_of_its_evidence_contradicts_the_belief():
    belief = evidence()
    assert KitWatch.fits(belief, prediction(evidence(turned=0.3 * TURNED)))
    assert not KitWatch.fits(belief, prediction(evidence(turned=TURNED)))
    # a lens does not change while driving
    assert KitWatch.fits(belief, prediction(evidence(focal=0.1)))
    assert not KitWatch.fits(belief, prediction(None))
    assert KitWatch.fits(None, prediction(evidence(turned=TURNED)))


def test_two_windows_in_a_row_that_agree_are_a_change():
    watch, belief = KitWatch(), evidence()
    assert watch.suspect(suspect(7, turned=TURNED), belief) is None
    slip = watch.suspect(suspect(8, turned=1.1 * TURNED), belief)
    assert slip is not None and [each.submap_id for each in slip.suspects] == [7, 8]
    assert "turned by 2.1 deg" in slip.text
    # the optics are those of before; of the rig nothing is known
    carried = slip.carried
    assert np.allclose(carried.information[layout.RIG], 0)
    assert carried.information[0, 0] == pytest.approx(belief.information[0, 0])
    assert watch.suspect(suspect(9, turned=TURNED), belief) is None


def test_focals_that_differ_and_a_drift_of_the_mount_are_no_change():
    for changed in ({"focal": 0.1}, {"turned": np.radians(0.6)}):
        watch, belief = KitWatch(), evidence()
        for number in range(4):
            assert watch.suspect(suspect(number, **changed), belief) is None


def test_bad_windows_one_at_a_time_are_no_change():
    watch, belief = KitWatch(), evidence()
    for number in range(6):
        assert watch.suspect(suspect(number, turned=TURNED), belief) is None
        watch.acquit()


def test_windows_that_contradict_each_other_are_no_change():
    watch, belief = KitWatch(), evidence()
    for number in range(3 * MOST):
        turned = TURNED if number % 2 else -TURNED
        assert watch.suspect(suspect(number, turned=turned), belief) is None


def test_the_rig_is_marginalised_out_of_what_is_carried():
    watch, belief = KitWatch(), evidence()
    coupled = belief.information.copy()
    focal, turn = int(layout.LOG_FOCAL[0]), layout.RIG_ROTATION.start + 1
    coupled[focal, turn] = coupled[turn, focal] = 0.5 * coupled[0, 0]
    belief = dataclasses.replace(belief, information=coupled)
    watch.suspect(suspect(1, turned=TURNED), belief)
    slip = watch.suspect(suspect(2, turned=TURNED), belief)
    variance = np.linalg.inv(coupled)[focal, focal]
    assert slip is not None
    assert 1 / slip.carried.information[focal, focal] == pytest.approx(variance)
