"""The order in which work is shed, and the way back."""

from __future__ import annotations

from calm_edge.config import DegradeConfig
from calm_edge.daemon.ladder import CALM_STEPS, Ladder, Load, Shed
from device.thermal import Thermal

CONFIG = DegradeConfig(hot_c=85, cool_c=75, behind_windows=4, step_s=10)
COOL, WARM, HOT = Load(Thermal(60), 0), Load(Thermal(80), 0), Load(Thermal(90), 0)
BEHIND = Load(Thermal(60), 5)


def steps(ladder: Ladder, load: Load, start_s: float, seconds: int) -> list[Shed]:
    """The different steps met, a call a second."""
    met: list[Shed] = []
    for k in range(seconds):
        shed = ladder.update(start_s + k, load)
        if not met or met[-1] is not shed:
            met.append(shed)
    return met


def test_heat_sheds_in_the_stated_order_and_cold_brings_all_back_more_slowly() -> None:
    ladder = Ladder(CONFIG, depth=True)
    assert steps(ladder, HOT, 0, 10) == [Shed.NOTHING]
    assert steps(ladder, HOT, 10, 60) == [Shed.DEPTH, Shed.HALF_THE_WINDOWS, Shed.ALL_WINDOWS]
    assert ladder.reasons == ("90 °C",)
    # between the limits nothing changes, however long
    assert steps(ladder, WARM, 100, 500) == [Shed.ALL_WINDOWS]
    assert steps(ladder, COOL, 1000, CALM_STEPS * 10) == [Shed.ALL_WINDOWS]
    assert steps(ladder, COOL, 1030, 61) == [Shed.HALF_THE_WINDOWS, Shed.DEPTH, Shed.NOTHING]


def test_a_short_heat_sheds_nothing() -> None:
    ladder = Ladder(CONFIG, depth=True)
    for start in range(0, 200, 20):
        assert steps(ladder, HOT, start, 9) == [Shed.NOTHING]
        assert steps(ladder, WARM, start + 9, 11) == [Shed.NOTHING]


def test_a_backlog_alone_never_sheds_all_windows() -> None:
    ladder = Ladder(CONFIG, depth=True)
    assert steps(ladder, BEHIND, 0, 500)[-1] is Shed.HALF_THE_WINDOWS
    assert ladder.reasons == ("5 windows wait",)


def test_windows_given_up_press_like_windows_that_wait() -> None:
    ladder = Ladder(CONFIG, depth=False)
    # they never wait long, for every few seconds newer ones go first
    for start in range(0, 30, 5):
        ladder.update(start, Load(Thermal(60), 1, overtaken=start))
    assert ladder.shed is Shed.HALF_THE_WINDOWS
    assert ladder.reasons == ("windows come faster than they are solved",)
    assert steps(ladder, Load(Thermal(60), 1, overtaken=25), 30, 60)[-1] is Shed.NOTHING


def test_windows_given_up_once_shed_nothing() -> None:
    ladder = Ladder(CONFIG, depth=False)
    assert steps(ladder, Load(Thermal(60), 1, overtaken=9), 0, 100) == [Shed.NOTHING]


def test_a_backlog_after_a_heat_leaves_the_step_where_it_was() -> None:
    ladder = Ladder(CONFIG, depth=True)
    steps(ladder, HOT, 0, 100)
    assert steps(ladder, BEHIND, 100, 100) == [Shed.ALL_WINDOWS]


def test_depth_that_is_not_made_is_no_step() -> None:
    ladder = Ladder(CONFIG, depth=False)
    assert steps(ladder, HOT, 0, 60) == [Shed.NOTHING, Shed.HALF_THE_WINDOWS, Shed.ALL_WINDOWS]


def test_throttling_presses_like_heat_and_no_sensor_like_none() -> None:
    ladder = Ladder(CONFIG, depth=False)
    throttled = Load(Thermal(throttled=True), 0)
    assert steps(ladder, throttled, 0, 30)[-1] is Shed.ALL_WINDOWS
    assert ladder.reasons == ("processor throttled",)
    assert steps(ladder, Load(Thermal(), 1), 30, 100)[-1] is Shed.NOTHING
