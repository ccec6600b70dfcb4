from __future__ import annotations

import pytest

from device.clock import RateKeeper, SystemClock
from device.errors import DeviceError
from tests.manual_clock import ManualClock

MS = 1_000_000


def test_manual_clock_moves_only_when_slept_on() -> None:
    clock = ManualClock(5)
    clock.sleep_until_ns(3)
    assert clock.now_ns() == 5
    clock.sleep_until_ns(9)
    clock.advance(2)
    assert clock.now_ns() == 11


def test_system_clock_never_wakes_early() -> None:
    clock = SystemClock()
    t_ns = clock.now_ns() + 5 * MS
    clock.sleep_until_ns(t_ns)
    assert t_ns <= clock.now_ns() < t_ns + 1000 * MS


def test_rate_keeper_stays_on_its_grid_when_ticks_are_late() -> None:
    clock = ManualClock(1000)
    keeper = RateKeeper(clock, 100)
    woke = []
    for work_ms in (3, 12, 3, 0, 9):
        clock.advance(work_ms * MS)
        keeper.wait()
        woke.append((clock.now_ns() - 1000) / MS)
    # the second tick starts at 10 and works until 22, 2 late; the third is on the grid again
    assert woke == [10, 22, 30, 40, 50]
    assert keeper.skipped == 0


def test_rate_keeper_skips_instead_of_bursting_after_a_stall() -> None:
    clock = ManualClock()
    keeper = RateKeeper(clock, 100)
    clock.advance(57 * MS)
    assert keeper.wait() == 47 * MS
    assert keeper.skipped == 4
    assert keeper.wait() == 0
    assert clock.now_ns() == 60 * MS


def test_rate_keeper_returns_how_late_it_woke() -> None:
    class Sluggish(ManualClock):
        def sleep_until_ns(self, t_ns: int) -> None:
            super().sleep_until_ns(t_ns + 300)

    assert RateKeeper(Sluggish(), 10).wait() == 300


def test_lagging_takes_several_late_ticks_and_clears() -> None:
    clock = ManualClock()
    keeper = RateKeeper(clock, 100)

    def tick(work_ms: int) -> bool:
        clock.advance(work_ms * MS)
        keeper.wait()
        return keeper.lagging

    assert not tick(25)
    assert not tick(25)
    assert tick(25)
    assert [tick(1) for _ in range(20)][-1] is False


@pytest.mark.parametrize("hz", [0.0, -1.0, float("nan")])
def test_a_rate_must_be_positive(hz: float) -> None:
    with pytest.raises(DeviceError, match="above 0"):
        RateKeeper(ManualClock(), hz)
