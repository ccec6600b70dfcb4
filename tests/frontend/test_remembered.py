"""Which remembered frames are worth looking at."""

from __future__ import annotations

from calm_edge.frontend.remembered import spaced

MS = 1_000_000


def test_at_ten_a_second_each_and_every_fourth() -> None:
    times = [i * 100 * MS for i in range(12)]
    assert spaced(times, times[2], 90 * MS) == list(range(3, 12))
    assert spaced(times, times[2], 390 * MS) == [6, 10, 11]


def test_at_thirty_a_second_as_many_as_at_ten() -> None:
    times = [i * 100 * MS // 3 for i in range(91)]
    assert spaced(times, times[0], 90 * MS) == list(range(3, 91, 3))
    assert spaced(times, times[0], 390 * MS) == [*range(12, 85, 12), 90]


def test_nothing_after_the_last() -> None:
    assert spaced([5, 6], 6, 1) == [] and spaced([], 0, 1) == []
