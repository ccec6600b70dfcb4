"""A calibration is used with small sigmas, and dropped where the drive contradicts it."""

import numpy as np
import pytest

from calm_edge.config import CalibratedCameraConfig, CalibrationConfig
from calm_edge.kit import layout
from calm_edge.kit.belief import blurred
from calm_edge.kit.calibrated import DROPPED_AFTER, RIG_TRUSTED_AFTER, CalibratedKit
from calm_edge.types import KitBelief

SIZES = np.array([[640, 360], [640, 360]])
CAMERA = CalibratedCameraConfig("perspective", 420.0, 420.0, 325.0, 178.0, 640, 360, (-0.02,))
RIG = (0.01, -0.02, 0.0, 1.0, 0.0, 0.0)
CONFIG = CalibrationConfig(cameras=(CAMERA, CAMERA), rig=RIG)


def opened(config=CONFIG):
    kit = CalibratedKit(config)
    assert kit.belief is None
    kit.open(SIZES)
    return kit


def evidence(turned_deg=0.0, focal=1.0, radial=0.0):
    """Evidence of turning windows that agree with CONFIG but for the given differences."""
    kit = opened()
    mean = kit.belief.mean.copy()
    mean[layout.RIG] = RIG
    mean[layout.RIG_ROTATION][1] += np.radians(turned_deg)
    mean[layout.LOG_FOCAL[0]] += np.log(focal)
    mean[layout.DISTORTION[0][0]] += radial
    sigma = np.full(layout.SIZE, 0.004)
    return KitBelief(mean, np.diag(sigma**-2.0))


def known(belief, terms):
    return belief is not None and bool(np.diag(belief.information)[terms].all())


def test_the_optics_are_known_at_once_and_the_rig_once_windows_agree():
    kit = opened()
    for _ in range(RIG_TRUSTED_AFTER):
        assert known(kit.belief, layout.OPTICS) and not known(kit.belief, layout.RIG)
        assert kit.contradicted(evidence()) == ()
    assert known(kit.belief, layout.OPTICS) and known(kit.belief, layout.RIG)
    assert np.allclose(kit.belief.mean[layout.RIG], RIG)


def compared(kit, found, times=DROPPED_AFTER):
    return [line for _ in range(times) for line in kit.contradicted(found)]


def test_a_bumped_mount_is_noticed_and_the_lenses_are_kept():
    kit = opened()
    (line,) = compared(kit, evidence(turned_deg=4.0))
    assert "the assistant has moved, turned by 4.0 deg; it is learned from driving" in line
    assert compared(kit, evidence(turned_deg=4.0), 5) == []
    assert known(kit.belief, layout.OPTICS) and not known(kit.belief, layout.RIG)


@pytest.mark.parametrize("change", [{"focal": 1.1}, {"radial": -0.1}])
def test_another_lens_is_noticed_and_only_this_eye_is_dropped(change):
    kit = opened()
    (line,) = compared(kit, evidence(**change))
    assert "another lens on the primary camera" in line
    assert not known(kit.belief, layout.OPTICS[0]) and known(kit.belief, layout.OPTICS[1])


def test_focals_that_do_not_fit_together_are_noticed_where_neither_is_known_well():
    kit = opened()
    found = evidence(focal=1.1)
    both = np.zeros(layout.SIZE)
    both[layout.LOG_FOCAL] = 1.0
    found = blurred(found, both, 0.07)
    (line,) = compared(kit, found)
    assert "ratio of their focals is off by +10.0 %" in line and kit.belief is None
    kit, agreeing = opened(), blurred(evidence(), both, 0.07)
    assert compared(kit, agreeing, 5) == [] and known(kit.belief, layout.OPTICS)


def test_one_bad_window_drops_nothing():
    kit = opened()
    for found in (evidence(4.0), evidence(), evidence(focal=1.1), evidence(), evidence(4.0)):
        assert kit.contradicted(found) == ()
    assert known(kit.belief, layout.OPTICS)


def test_evidence_that_knows_nothing_contradicts_nothing():
    kit = opened()
    found = evidence(turned_deg=20.0, focal=1.5)
    vague = KitBelief(found.mean, np.eye(layout.SIZE) * 1e-3)
    assert compared(kit, vague, 5) == [] and compared(kit, None, 2) == []


def test_a_slipped_mount_leaves_the_optics():
    kit = opened()
    compared(kit, evidence(), RIG_TRUSTED_AFTER)
    held = kit.after_change(lens=False)
    assert known(held, layout.OPTICS) and not known(kit.belief, layout.RIG)
    assert kit.after_change(lens=True) is None and kit.belief is None


def test_sizes_are_said_with_the_first_comparison():
    kit = CalibratedKit(CONFIG)
    kit.open(np.array([[1280, 720], [640, 480]]))
    scaled, cropped = kit.contradicted(None)
    assert "scaled" in scaled and "assistant" in cropped
    assert kit.contradicted(None) == () and not known(kit.belief, layout.OPTICS[1])


def test_without_a_calibration_there_is_nothing():
    kit = opened(CalibrationConfig())
    assert kit.belief is None and kit.contradicted(evidence()) == ()
