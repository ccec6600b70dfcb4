"""Gain and offset between pictures are found, and make no difference to matching."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from calm_edge.geometry import brightness
from calm_edge.geometry.brightness import Brightness
from calm_edge.geometry.flow import TRACKING, LucasKanade, follow, follow_ahead

SIZE = (320, 160)
SHIFT = np.array([3.4, -1.7], np.float32)
# no pixel is saturated by a gain of 1.4
_NOISE = np.random.default_rng(0).normal(size=SIZE[::-1]).astype(np.float32)
_SOFT = cv2.GaussianBlur(_NOISE, (0, 0), 1.6) + 2 * cv2.GaussianBlur(_NOISE, (0, 0), 6.0)
SOURCE = cv2.normalize(_SOFT, None, 10, 170, cv2.NORM_MINMAX).astype(np.uint8)
MOVE = np.array([[1, 0, SHIFT[0]], [0, 1, SHIFT[1]]], np.float32)
TARGET = cv2.warpAffine(SOURCE, MOVE, SIZE, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
_AT = np.random.default_rng(1).uniform([20, 20], [300, 140], (200, 2)).astype(np.float32)

CHANGES = [(1.05, 0.0), (1.4, 0.0), (0.8, 0.0), (0.6, 40.0), (0.4, 0.0), (0.25, 0.0), (1.0, 25.0)]


def changed(picture: np.ndarray, gain: float, offset: float) -> np.ndarray:
    return np.clip(np.rint(gain * picture + offset), 0, 255).astype(np.uint8)


@pytest.mark.parametrize(("gain", "offset"), CHANGES)
def test_the_change_is_measured_at_points_in_spite_of_wrong_matches(
    gain: float, offset: float
) -> None:
    moved = _AT + SHIFT
    moved[::4] += np.random.default_rng(2).normal(0, 40, (50, 2)).astype(np.float32)
    moved = np.clip(moved, 0, np.array(SIZE) - 1).astype(np.float32)
    found = brightness.at_points(SOURCE, changed(TARGET, gain, offset), _AT, moved)
    assert found is not None
    assert found.gain == pytest.approx(gain, rel=0.015)
    middle = found.gain * 90 + found.offset
    assert middle == pytest.approx(gain * 90 + offset, abs=1.5)


@pytest.mark.parametrize(("gain", "offset"), CHANGES)
def test_histograms_give_it_roughly_although_a_part_of_the_picture_is_empty(
    gain: float, offset: float
) -> None:
    target = changed(TARGET, gain, offset)
    target[:, 200:] = 0
    found = brightness.of_histograms(SOURCE, target)
    assert found is not None
    assert found.gain == pytest.approx(gain, rel=0.15)


@pytest.mark.parametrize(("gain", "offset"), CHANGES)
def test_tracking_does_not_depend_on_the_brightness(gain: float, offset: float) -> None:
    moved, good = follow(SOURCE, TARGET, _AT)
    assert good.sum() > 150
    for images in (
        (SOURCE, changed(TARGET, gain, offset)),
        (changed(SOURCE, gain, offset), TARGET),
    ):
        again, still = follow(*images, _AT)
        assert (good & still).sum() >= 0.93 * good.sum()
        both = good & still
        assert np.median(np.linalg.norm(again - moved, axis=1)[both]) < 0.06


def test_without_it_a_change_of_gain_loses_the_tracks() -> None:
    """What is tested above is not true of Lucas-Kanade alone."""
    dark = changed(TARGET, 0.6, 0.0)
    ahead, _ = follow_ahead(SOURCE, dark, _AT, _AT, TRACKING)
    assert (np.linalg.norm(ahead - _AT - SHIFT, axis=1) < 0.3).mean() < 0.4


def test_equal_brightness_changes_nothing() -> None:
    """Not even the last bit."""
    how = LucasKanade()
    moved, good = follow(SOURCE, TARGET, _AT, None, how)
    ahead, found = follow_ahead(SOURCE, TARGET, _AT, _AT, how)
    np.testing.assert_array_equal(moved, ahead)
    assert not (good & ~found).any()
    small = Brightness(1.01, -0.5, 90.0)
    one, other = brightness.alike(SOURCE, TARGET, small)
    assert one is SOURCE and other is TARGET


def test_a_blank_or_black_picture_has_no_change() -> None:
    black, grey = np.zeros_like(SOURCE), np.full_like(SOURCE, 90)
    assert brightness.of_histograms(SOURCE, black) is None
    assert brightness.at_points(SOURCE, black, _AT, _AT) is None
    assert brightness.at_points(SOURCE, TARGET, _AT[:5], _AT[:5]) is None
    for target in (black, grey, np.full_like(SOURCE, 255)):
        _, good = follow(SOURCE, target, _AT)
        assert good.mean() < 0.2
    assert brightness.evened(SOURCE, black)[1] is black
