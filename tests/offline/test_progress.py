"""Progress lines: how many of how many, and the time that is left."""

from __future__ import annotations

import pytest

from calm_edge.offline.progress import Progress, duration


class Steps:
    """A progress on a clock that is set by hand, and its lines."""

    def __init__(self, total: int | None) -> None:
        self.now_s = 100.0
        self.lines: list[str] = []
        self.progress = Progress("solving", total, self.lines.append, lambda: self.now_s)

    def step(self, took_s: float, *, free: bool = False) -> None:
        self.now_s += took_s
        self.progress.step(free=free)


def test_each_slow_item_has_a_line_with_the_time_left() -> None:
    steps = Steps(4)
    for _ in range(4):
        steps.step(10.0)
    assert steps.lines == [
        "solving: 1 of 4, about 30 s left",
        "solving: 2 of 4, about 20 s left",
        "solving: 3 of 4, about 10 s left",
        "solving: 4 of 4",
    ]


def test_fast_items_share_a_line_and_the_last_has_one() -> None:
    steps = Steps(1000)
    for _ in range(1000):
        steps.step(0.01)
    assert 5 <= len(steps.lines) <= 7 and steps.lines[-1] == "solving: 1000 of 1000"


def test_items_that_took_no_time_do_not_shorten_the_estimate() -> None:
    steps = Steps(10)
    for _ in range(5):
        steps.step(0.0, free=True)
    assert steps.lines == ["solving: 1 of 10"]
    steps.step(60.0)
    assert steps.lines[-1] == "solving: 6 of 10, about 4 min left"


def test_an_item_that_is_left_out_does_not_count() -> None:
    steps = Steps(3)
    steps.step(5.0)
    steps.progress.leave_out()
    steps.step(5.0)
    assert steps.lines == ["solving: 1 of 3, about 10 s left", "solving: 2 of 2"]


def test_without_a_total_items_are_counted() -> None:
    steps = Steps(None)
    steps.step(5.0)
    steps.step(5.0)
    assert steps.lines == ["solving: 1", "solving: 2"]


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0.2, "1 s"), (99, "99 s"), (100, "2 min"), (5950, "99 min"), (12_000, "3 h 20 min")],
)
def test_durations(seconds: float, text: str) -> None:
    assert duration(seconds) == text
