"""A receiver on a serial line that is good, garbled, silent or unplugged."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from device.gps import reception
from device.gps.serial_gps import SerialGps
from tests.device.gps.sentences import measurement
from tests.device.test_serial_port import Line

T_NS = 1_700_000_000 * 10**9


def until(condition: Callable[[], bool]) -> None:
    limit = time.monotonic() + 5
    while not condition():
        assert time.monotonic() < limit
        time.sleep(0.01)


@pytest.fixture
def line(tmp_path: Path) -> Iterator[Line]:
    line = Line(tmp_path / "tty")
    line.plug()
    yield line
    line.unplug()


def test_fixes_are_stamped_on_arrival_and_each_fault_is_named(
    line: Line, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reception, "SILENT_S", 0.3)
    gps = SerialGps(str(line.name), 9600, time.monotonic_ns)
    gps.start()
    try:
        until(lambda: gps._port.connected)
        before_ns = time.monotonic_ns()
        for k in range(3):
            os.write(line.master, measurement(T_NS + k * 10**9, 48.0, 11.0, 500.0).encode())
        found: list[object] = []
        until(lambda: bool(found.extend(gps.take(0)) or len(found) == 2))
        # the third is complete with the next one
        assert all(before_ns < fix.t_ns < time.monotonic_ns() for fix in found)  # type: ignore[attr-defined]
        assert gps.fault == ""
        until(lambda: "sends nothing" in gps.fault)

        def garbled() -> bool:
            os.write(line.master, b"\xff\x00garbage\n")
            return "sends no NMEA; check gps.baud = 9600" in gps.fault

        until(garbled)
        line.unplug()
        until(lambda: "lost" in gps.fault or "cannot be opened" in gps.fault)
        line.plug()
    finally:
        gps.stop()
