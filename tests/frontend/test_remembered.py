"""Selection of past frames by time."""

from __future__ import annotations

from calm_edge.frontend.remembered import spaced

MS = 1_000_000


def test_at_10_hz_all_and_every_fourth() -> None:
    times = [i * 100 * MS for i in range(12)]
    assert spaced(times, times[2], 90 * MS) == list(range(3, 12))
    assert spaced(times, times[2], 390 * MS) == [6, 10, 11]


def test_at_30_hz_as_many_as_at_10_hz() -> None:
    times = [i * 100 * MS // 3 for i in range(91)]
    assert spaced(times, times[0], 90 * MS) == list(range(3, 91, 3))
    assert spaced(times, times[0], 390 * MS) == [*range(12, 85, 12), 90]


def test_none_after_the_last() -> None:
    assert spaced([5, 6], 6, 1) == [] and spaced([], 0, 1) == []
