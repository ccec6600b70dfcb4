"""Single stamps out of order are found and replaced where the frames are."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from calm_edge.recording.stamp_order import ordered

MS = 10**6
# ten pictures a second with jitter, five of them lost
TRUE = (
    np.delete(np.arange(60) * 100 + np.random.default_rng(0).integers(-8, 8, 60), range(40, 45))
    * MS
)


def glitch(t: np.ndarray) -> None:
    t[14:25] -= 410 * MS


def twice(t: np.ndarray) -> None:
    t[20] = t[19]


def standing(t: np.ndarray) -> None:
    t[5:8] = t[5]


def spike(t: np.ndarray) -> None:
    t[13] += 9000 * MS


def zero_at_the_end(t: np.ndarray) -> None:
    t[-1] = 0


def not_yet_set(t: np.ndarray) -> None:
    t[:2] += 10**18


def swapped(t: np.ndarray) -> None:
    t[[30, 31]] = t[[31, 30]]


@pytest.mark.parametrize(
    ("spoil", "wrong"),
    [
        (glitch, range(14, 25)),
        (twice, [20]),
        (standing, [6, 7]),
        (spike, [13]),
        (zero_at_the_end, [54]),
        (not_yet_set, [0, 1]),
        (swapped, [30, 31]),
    ],
)
def test_wrong_stamps_are_replaced_by_regular_ones(
    spoil: Callable[[np.ndarray], None], wrong: list[int]
) -> None:
    t_ns = TRUE.copy()
    spoil(t_ns)
    found, own = ordered(t_ns)
    assert np.flatnonzero(~own).tolist() == list(wrong)
    np.testing.assert_array_equal(found[own], TRUE[own])
    assert np.abs(found - TRUE).max() < 20 * MS and (np.diff(found) > 0).all()


def test_a_clock_that_is_set_back_goes_on_from_there() -> None:
    t_ns = TRUE.copy()
    t_ns[20:] -= 5000 * MS
    found, own = ordered(t_ns)
    assert np.flatnonzero(~own).tolist() == [20]
    assert np.abs(found - TRUE).max() < 20 * MS


def test_too_many_wrong_stamps_are_left_as_they_are() -> None:
    for t_ns in (TRUE[::-1], np.random.default_rng(2).permutation(TRUE), 0 * TRUE):
        np.testing.assert_array_equal(ordered(t_ns)[0], t_ns)


def test_stamps_in_order_are_not_touched() -> None:
    irregular = np.cumsum(np.random.default_rng(1).integers(1, 500, 50)) * MS
    for t_ns in (TRUE, irregular, irregular[:1], irregular[:0]):
        found, own = ordered(t_ns)
        np.testing.assert_array_equal(found, t_ns)
        assert own.all()


@pytest.mark.parametrize("first", [1, 30, 54])
def test_a_clock_set_ahead_is_followed_at_the_regular_step(first: int) -> None:
    t_ns = TRUE.copy()
    t_ns[first:] += 56 * 365 * 86_400 * 1000 * MS
    found, own = ordered(t_ns)
    assert np.flatnonzero(~own).tolist() == [first]
    assert np.abs(found - TRUE).max() < 20 * MS


def test_an_hour_without_pictures_is_no_setting_of_the_clock() -> None:
    t_ns = TRUE.copy()
    t_ns[30:] += 3600 * 1000 * MS
    found, own = ordered(t_ns)
    assert own.all() and (found == t_ns).all()
