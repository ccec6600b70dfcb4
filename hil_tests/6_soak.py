"""Test 6: minutes of recording, for losses, memory growth and temperature."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

from calm_edge.recording.reader import Recording
from device.frame import Eye
from hil_tests.daemon import recording
from hil_tests.kit import Kit
from hil_tests.report import Row, judged, skipped

NAME = "6 soak"
WATCHDOG_S = 5.0
START_LIMIT_S = 60.0
STOP_LIMIT_S = 60.0
LOOK_S = 5.0
# memory is judged after this part of the run (1/N): libraries load and windows fill in it
SETTLED = 5
MOST_GROWTH_MIB_MINUTE = 5.0
# a shorter run shows windows that fill up, not a leak
LEAST_MINUTES = 5.0


def hottest_celsius() -> float | None:
    """Return the temperature of the hottest thermal zone; None if the kernel shows none."""
    found = []
    for zone in Path("/sys/class/thermal").glob("thermal_zone*/temp"):
        try:
            found.append(int(zone.read_text()) / 1000)
        except (OSError, ValueError):
            continue
    return max(found, default=None)


def rows(kit: Kit) -> Iterator[Row]:
    """Yield memory, temperature, and the frames in the recording."""
    absent = kit.absent()
    if absent:
        yield skipped(NAME, "recording", absent)
        return
    with recording(kit, "soak", WATCHDOG_S) as daemon:
        if not daemon.ready_within(START_LIMIT_S):
            yield judged(NAME, "recording", False, daemon.last_line(), "starts")
            return
        started, memory, heat = time.monotonic(), [], []
        while time.monotonic() - started < 60 * kit.minutes and daemon.listen(
            min(LOOK_S, 60 * kit.minutes / 10)
        ):
            memory.append((time.monotonic() - started, daemon.rss_mib()))
            heat.append(hottest_celsius())
        ran_s = time.monotonic() - started
        code, _ = daemon.stop(STOP_LIMIT_S)
    yield judged(NAME, "end", code in (0, 3), f"exit {code} after {ran_s / 60:.1f} min", "0 or 3")
    settled = memory[len(memory) // SETTLED :]
    if kit.minutes < LEAST_MINUTES or len(settled) < 2:
        yield skipped(NAME, "memory", f"needs {LEAST_MINUTES:g} minutes")
    else:
        (t0, first), (t1, last) = settled[0], settled[-1]
        growth = (last - first) / max(1e-9, (t1 - t0) / 60)
        text = f"{first:.0f} -> {last:.0f} MiB, {growth:+.1f} MiB a minute"
        good = growth < MOST_GROWTH_MIB_MINUTE
        yield judged(NAME, "memory", good, text, f"under {MOST_GROWTH_MIB_MINUTE:g} MiB a minute")
    hot = [h for h in heat if h is not None]
    if hot:
        yield judged(NAME, "heat", max(hot) < 95, f"{max(hot):.0f} °C at most", "under 95 °C")
    else:
        yield skipped(NAME, "heat", "the kernel shows no thermal zone")
    yield from of_recording(daemon.out, kit.config.capture.rate_hz)


def of_recording(out: Path, requested_hz: float) -> Iterator[Row]:
    """Yield the frame rate of each eye in the recording, from its first to its last frame."""
    held = Recording(out)
    yield judged(NAME, "readable", not held.losses, "; ".join(held.losses) or "whole", "whole")
    for eye in Eye:
        t_ns = held.frame_times(eye)
        name = f"{eye.name.lower()} frames"
        if len(t_ns) < 2:
            yield judged(NAME, name, False, f"{len(t_ns)}", "some")
            continue
        span_s = (int(t_ns.max()) - int(t_ns.min())) / 1e9
        text = f"{len(t_ns)} in {span_s:.0f} s, {(len(t_ns) - 1) / span_s:.2f} Hz"
        good = (len(t_ns) - 1) / span_s >= 0.9 * requested_hz
        yield judged(NAME, name, good, text, f"{requested_hz:g} Hz requested, at least 90 %")
