"""Order in which work is reduced and resumed."""

from __future__ import annotations

from calm_edge.config import DegradeConfig
from calm_edge.daemon.ladder import CALM_STEPS, Ladder, Load, Shed
from device.thermal import Thermal

CONFIG = DegradeConfig(hot_c=85, cool_c=75, behind_windows=4, step_s=10)
COOL, WARM, HOT = Load(Thermal(60), 0), Load(Thermal(80), 0), Load(Thermal(90), 0)
BEHIND = Load(Thermal(60), 5)


def steps(ladder: Ladder, load: Load, start_s: float, seconds: int) -> list[Shed]:
    """Return the sequence of different steps, with one update per second."""
    met: list[Shed] = []
    for k in range(seconds):
        shed = ladder.update(start_s + k, load)
        if not met or met[-1] is not shed:
            met.append(shed)
    return met


def test_heat_reduces_work_in_order_and_it_resumes_more_slowly() -> None:
    ladder = Ladder(CONFIG, depth=True)
    assert steps(ladder, HOT, 0, 10) == [Shed.NOTHING]
    assert steps(ladder, HOT, 10, 60) == [Shed.DEPTH, Shed.HALF_THE_WINDOWS, Shed.ALL_WINDOWS]
    assert ladder.reasons == ("90 °C",)
    # between the limits nothing ever changes
    assert steps(ladder, WARM, 100, 500) == [Shed.ALL_WINDOWS]
    assert steps(ladder, COOL, 1000, CALM_STEPS * 10) == [Shed.ALL_WINDOWS]
    assert steps(ladder, COOL, 1030, 61) == [Shed.HALF_THE_WINDOWS, Shed.DEPTH, Shed.NOTHING]


def test_a_short_peak_of_temperature_changes_nothing() -> None:
    ladder = Ladder(CONFIG, depth=True)
    for start in range(0, 200, 20):
        assert steps(ladder, HOT, start, 9) == [Shed.NOTHING]
        assert steps(ladder, WARM, start + 9, 11) == [Shed.NOTHING]


def test_a_backlog_alone_does_not_stop_all_windows() -> None:
    ladder = Ladder(CONFIG, depth=True)
    assert steps(ladder, BEHIND, 0, 500)[-1] is Shed.HALF_THE_WINDOWS
    assert ladder.reasons == ("5 windows wait to be solved",)


def test_overtaken_windows_count_like_waiting_ones() -> None:
    ladder = Ladder(CONFIG, depth=False)
    # the queue stays short, since every few seconds windows are overtaken by a newer one
    for start in range(0, 30, 5):
        ladder.update(start, Load(Thermal(60), 1, overtaken=start))
    assert ladder.shed is Shed.HALF_THE_WINDOWS
    assert ladder.reasons == ("windows come faster than they are solved",)
    assert steps(ladder, Load(Thermal(60), 1, overtaken=25), 30, 60)[-1] is Shed.NOTHING


def test_overtaken_windows_of_the_past_change_nothing() -> None:
    ladder = Ladder(CONFIG, depth=False)
    assert steps(ladder, Load(Thermal(60), 1, overtaken=9), 0, 100) == [Shed.NOTHING]


def test_a_backlog_after_overheating_keeps_the_step() -> None:
    ladder = Ladder(CONFIG, depth=True)
    steps(ladder, HOT, 0, 100)
    assert steps(ladder, BEHIND, 100, 100) == [Shed.ALL_WINDOWS]


def test_without_depth_its_step_is_skipped() -> None:
    ladder = Ladder(CONFIG, depth=False)
    assert steps(ladder, HOT, 0, 60) == [Shed.NOTHING, Shed.HALF_THE_WINDOWS, Shed.ALL_WINDOWS]


def test_throttling_counts_like_heat_and_a_missing_sensor_like_cool() -> None:
    ladder = Ladder(CONFIG, depth=False)
    throttled = Load(Thermal(throttled=True), 0)
    assert steps(ladder, throttled, 0, 30)[-1] is Shed.ALL_WINDOWS
    assert ladder.reasons == ("processor throttled",)
    assert steps(ladder, Load(Thermal(), 1), 30, 100)[-1] is Shed.NOTHING
