from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest

from hil_tests.vm import power_cut
from tests.manual_clock import ManualClock


def test_the_guests_clock_is_that_of_the_smallest_difference(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    host = ManualClock(50_000_000_000)
    fake = SimpleNamespace(
        monotonic=lambda: host.now_ns() / 1e9, sleep=lambda s: host.advance(round(s * 1e9))
    )
    monkeypatch.setattr(power_cut, "time", fake)
    file = tmp_path / "clock"
    clock = power_cut.GuestClock(file)
    ahead_s = 1000.0
    for late_s in (0.7, 0.0, 0.4):
        file.write_text(f"{fake.monotonic() + ahead_s - late_s:.3f}\n")
        clock.watch(0.02)
    file.write_text("12")  # half written
    clock.watch(0.02)
    assert clock.now_s() == pytest.approx(fake.monotonic() + ahead_s, abs=1e-3)
