"""Test 2: both cameras, at the same time, deliver the requested frame rate."""

from __future__ import annotations

from collections.abc import Iterator

from device.errors import DeviceError
from hil_tests.kit import Kit, watch
from hil_tests.report import Row, judged, skipped

NAME = "2 frame rate"
WATCHED_S = 20.0
# a camera takes the nearest rate it has; a lower share of it means too little bus bandwidth, or a
# long exposure in the dark
LEAST_SHARE = 0.9
MOST_DROPS_PERCENT = 0.1


def rows(kit: Kit) -> Iterator[Row]:
    """Yield rate, drops and unusable buffers of each eye."""
    absent = kit.absent()
    if absent:
        yield skipped(NAME, "both eyes", absent)
        return
    try:
        both = watch(kit, WATCHED_S)
    except DeviceError as error:
        yield judged(NAME, "both eyes", False, str(error), "open")
        return
    requested_hz = kit.config.capture.rate_hz
    for seen in both:
        eye = seen.thread.camera.spec.eye.name.lower()
        stats = seen.thread.camera.stats()
        rate_hz = seen.rate_hz
        good = rate_hz >= LEAST_SHARE * requested_hz
        wanted = f"{requested_hz:g} Hz requested, at least {LEAST_SHARE:.0%}"
        yield judged(
            NAME, f"{eye} rate", good, f"{rate_hz:.2f} Hz, {len(seen.frames)} frames", wanted
        )
        lost = stats.drops + stats.corrupt + seen.thread.overflow
        percent = 100 * lost / max(1, stats.frames + lost)
        losses = (
            f"{stats.drops} dropped, {stats.corrupt} unusable, {seen.thread.overflow} overflowed"
        )
        if seen.thread.error:
            losses += f"; {seen.thread.error}"
        good = percent <= MOST_DROPS_PERCENT and not seen.thread.error
        yield judged(NAME, f"{eye} losses", good, losses, f"{MOST_DROPS_PERCENT} % at most")
