"""Test 3: timestamps come from the kernel, increase, and share one clock between the eyes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from device.errors import DeviceError
from hil_tests.kit import Kit, watch
from hil_tests.report import Row, judged, skipped

NAME = "3 timestamps"
WATCHED_S = 20.0
# exposure, transfer and polling every 2 ms; more is a driver that stamps late or holds frames back
MOST_DELAY_MS = 150.0


def rows(kit: Kit) -> Iterator[Row]:
    """Yield clock, gaps and delay of each eye, and the time between the eyes' frames."""
    absent = kit.absent()
    if absent:
        yield skipped(NAME, "both eyes", absent)
        return
    try:
        both = watch(kit, WATCHED_S)
    except DeviceError as error:
        yield judged(NAME, "both eyes", False, str(error), "open")
        return
    stamps = [np.array([frame.t_ns for frame in seen.frames], np.int64) for seen in both]
    for seen, t_ns in zip(both, stamps, strict=True):
        eye, stats = seen.thread.camera.spec.eye.name.lower(), seen.thread.camera.stats()
        if len(t_ns) < 3:
            yield judged(NAME, eye, False, f"{len(t_ns)} frames", "at least 3")
            return
        text = f"{stats.host_stamped} of {stats.frames} by the host, {stats.clamped} moved"
        good = not stats.host_stamped and not stats.clamped
        yield judged(NAME, f"{eye} clock", good, text, "all by the kernel, none moved")
        gaps_ms = np.diff(t_ns) / 1e6
        p50, p99 = np.percentile(gaps_ms, [50, 99])
        text = f"gap p50 {p50:.2f} ms, p99 {p99:.2f} ms"
        yield judged(NAME, f"{eye} gaps", bool(gaps_ms.min() > 0), text, "always increasing")
        delay_ms = (np.array(seen.arrived_ns, np.int64) - t_ns) / 1e6
        p50, p99 = np.percentile(delay_ms, [50, 99])
        text = f"stamp to arrival p50 {p50:.1f} ms, p99 {p99:.1f} ms"
        wanted = f"p50 under {MOST_DELAY_MS:g} ms, never negative"
        good = bool(delay_ms.min() >= 0) and p50 < MOST_DELAY_MS
        yield judged(NAME, f"{eye} delay", good, text, wanted)
    nearest = np.abs(stamps[0][:, None] - stamps[1][None]).min(axis=1) / 1e6
    limit_ms = 1000 * kit.config.frontend.max_pair_gap_s
    text = f"nearest frame of the other eye: median {np.median(nearest):.1f} ms"
    yield judged(NAME, "eyes", bool(np.median(nearest) < limit_ms), text, f"under {limit_ms:g} ms")
