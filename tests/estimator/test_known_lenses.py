"""Lenses of a drive: of a calibration, of the kit file, or of the first turns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calm_edge.backbones.base import BackboneError
from calm_edge.config import CalibratedCameraConfig, CalibrationConfig, Config
from calm_edge.estimator import known_lenses
from calm_edge.estimator.known_lenses import MOST_WINDOWS, KnownLenses
from calm_edge.geometry import se3
from calm_edge.kit import layout
from calm_edge.types import Hints, KitBelief, Prediction

SIZES = np.array([[640, 360], [640, 360]])
ENTRY = CalibratedCameraConfig("perspective", 500, 500, 319.5, 179.5, 640, 360, (-0.2, 0.05))
CALIBRATED = replace(Config(), calibration=CalibrationConfig(cameras=(ENTRY, ENTRY)))
HINTS = Hints(np.repeat([0, 1], 5), np.tile(np.arange(5), 2))


def belief(k1: float, sigma: float = 0.002) -> KitBelief:
    mean = layout.prior((80.0, 80.0)).mean.copy()
    mean[layout.DISTORTION] = [[k1, -k1 / 4]] * 2
    terms = layout.OPTICS.ravel()
    information = np.zeros((layout.SIZE, layout.SIZE))
    information[terms, terms] = sigma**-2
    return KitBelief(mean, layout.with_known_families(information))


class Prior:
    """Belief of earlier drives, or none."""

    def __init__(self, earlier: KitBelief | None = None) -> None:
        self.earlier = earlier


class Bundle:
    """Finds lenses, each window another, or fails."""

    def __init__(self, *found: KitBelief | None) -> None:
        self.found, self.asked = list(found), []

    def infer(self, images, hints):
        self.asked.append(hints)
        kit = self.found.pop(0)
        if kit is None:
            raise BackboneError("bundle: too few points")
        return Prediction((), np.zeros((0, 4, 4)), kit=kit)


def turning(deg: float) -> Prediction:
    """Five views of each eye, turned by an angle in all."""
    step = se3.exp(np.array([0, 0, 1, 0, np.radians(deg) / 4, 0]))
    path = np.stack([np.linalg.matrix_power(step, k) for k in range(5)])
    return Prediction((), np.concatenate([path, path]))


@pytest.fixture
def bundle(monkeypatch):
    def opened(*found: KitBelief | None) -> Bundle:
        made = Bundle(*found)
        monkeypatch.setattr(known_lenses, "open_backbone", lambda config: made)
        return made

    return opened


def test_nothing_is_known_of_a_kit_at_first_and_one_line_says_so():
    lenses = KnownLenses(Config(), Prior())
    assert lenses.notices == () and lenses.of(None) == (None, None)
    assert lenses.of(SIZES) == (None, None)
    (line,) = lenses.notices
    assert "lens of the primary and the assistant is not known yet" in line


def test_a_calibration_is_used_at_once_and_before_the_kit_file():
    lenses = KnownLenses(CALIBRATED, Prior(belief(-0.1)))
    assert [lens.distortion for lens in lenses.of(SIZES)] == [(-0.2, 0.05)] * 2
    assert lenses.notices == (
        "the pictures of the primary and the assistant are undistorted, by the lens of "
        "the calibration",
    )


def test_an_eye_without_a_calibration_has_the_lens_of_earlier_drives():
    config = replace(Config(), calibration=CalibrationConfig(cameras=(ENTRY,)))
    lenses = KnownLenses(config, Prior(belief(-0.1)))
    primary, assistant = lenses.of(SIZES)
    assert primary.distortion[0] == -0.2
    assert assistant.distortion[0] == pytest.approx(-0.1, abs=1e-3)
    assert len(lenses.notices) == 2
    doubtful = KnownLenses(config, Prior(belief(-0.1, sigma=0.2)))
    assert doubtful.of(SIZES)[1] is None


def test_bundle_solves_the_windows_with_a_turn_until_they_show_the_lens(bundle):
    lenses = KnownLenses(Config(), Prior())
    made = bundle(None, belief(-0.1, sigma=0.06), belief(-0.1))
    lenses.of(SIZES)
    lenses.learn([], HINTS, turning(3.0))
    assert not made.asked
    for known in (False, False, True):
        lenses.learn([], HINTS, turning(30.0))
        assert (lenses.of(SIZES)[0] is not None) == known
    assert made.asked[1].kit is None and made.asked[2].kit is not None
    assert lenses.of(SIZES)[1].distortion[0] == pytest.approx(-0.1, abs=1e-3)
    assert "the first turns" in lenses.notices[0]


def test_a_lens_is_kept_until_it_moves_by_more_than_a_pixel(bundle):
    lenses = KnownLenses(Config(), Prior())
    bundle(belief(-0.1), belief(-0.1002), *[belief(-0.13)] * MOST_WINDOWS)
    lenses.of(SIZES)
    found = []
    for _ in range(4):
        lenses.learn([], HINTS, turning(30.0))
        found.append(lenses.of(SIZES)[0])
    assert found[1] is found[0] and found[2] is not found[0]


def test_bundle_is_asked_for_few_windows_and_none_behind_a_calibration(bundle):
    made = bundle(*[None] * (MOST_WINDOWS + 1))
    calibrated = KnownLenses(CALIBRATED, Prior())
    calibrated.of(SIZES)
    calibrated.learn([], HINTS, turning(30.0))
    assert not made.asked
    lenses = KnownLenses(Config(), Prior())
    lenses.of(SIZES)
    for _ in range(MOST_WINDOWS + 1):
        lenses.learn([], HINTS, turning(30.0))
    assert len(made.asked) == MOST_WINDOWS and lenses.evidence is None


def test_a_loop_keyframe_is_no_part_of_what_bundle_solves(bundle):
    made = bundle(belief(-0.1))
    lenses = KnownLenses(Config(), Prior())
    lenses.of(SIZES)
    hints = Hints(np.append(HINTS.eyes, 0), np.append(HINTS.t_ns, 0), loop=True)
    window = turning(30.0)
    looped = replace(window, T_s_c=np.concatenate([window.T_s_c, window.T_s_c[:1]]))
    lenses.learn([np.zeros((4, 4, 3), np.uint8)] * 11, hints, looped)
    assert len(made.asked[0].eyes) == 10 and not made.asked[0].loop
