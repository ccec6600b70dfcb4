"""The thermal reader on fake sysfs trees."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import pytest

from device.thermal import Thermal, ThermalReader, ThermalWatch


def entry(root: Path, name: str, **files: str) -> None:
    folder = root / name
    folder.mkdir(parents=True)
    for file, text in files.items():
        (folder / file).write_text(text + "\n")


def test_the_hottest_plausible_zone_is_reported(tmp_path: Path) -> None:
    entry(tmp_path, "thermal_zone0", type="cpu-thermal", temp="61234")
    entry(tmp_path, "thermal_zone1", type="gpu", temp="70500")
    entry(tmp_path, "thermal_zone2", type="unconnected", temp="-274000")
    entry(tmp_path, "thermal_zone3", type="bogus", temp="999000")
    entry(tmp_path, "thermal_zone4", type="broken", temp="n/a")
    entry(tmp_path, "thermal_zone5", type="silent")
    assert ThermalReader(tmp_path).read() == Thermal(70.5, False)


@pytest.mark.parametrize(
    ("kind", "level", "throttled"),
    [
        ("Processor", "3", True),
        ("thermal-cpufreq-0", "1", True),
        ("cpu-isolation", "2", True),
        ("Processor", "0", False),
        ("intel_powerclamp", "-1", False),
        ("pwm-fan", "4", False),
        ("Processor", "?", False),
    ],
)
def test_only_processor_cooling_counts_as_throttling(
    tmp_path: Path, kind: str, level: str, throttled: bool
) -> None:
    entry(tmp_path, "cooling_device0", type=kind, cur_state=level)
    assert ThermalReader(tmp_path).read() == Thermal(None, throttled)


def test_without_sensors_there_is_no_temperature(tmp_path: Path) -> None:
    assert ThermalReader(tmp_path / "none").read() == Thermal()


def test_thermal_watch_updates_without_blocking_on_a_slow_sensor(tmp_path: Path) -> None:
    class Slow(ThermalReader):
        def read(self) -> Thermal:
            assert go.wait(10)
            return super().read()

    go = threading.Event()
    entry(tmp_path, "thermal_zone0", type="cpu", temp="61000")
    watch = ThermalWatch(Slow(tmp_path), 0.001)
    assert watch.latest == Thermal()
    go.set()
    for celsius in (61.0, 92.0):
        (tmp_path / "thermal_zone0" / "temp").write_text(f"{celsius * 1000:.0f}")
        end = time.monotonic() + 10
        while watch.latest.celsius != celsius:
            assert time.monotonic() < end
            time.sleep(0.001)
    watch.stop()
