"""Wake-up latency of the capture loop, statistics of one second and of the whole run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

_BIN_MS = 0.05
_BINS = 40_000


@dataclass(frozen=True, slots=True)
class TickLatency:
    """Statistics of the delay [ms] of loop cycles (ticks) after their deadlines; default: none."""

    ticks: int = 0
    p50_ms: float = 0.0
    p99_ms: float = 0.0
    max_ms: float = 0.0


class TickLatencyMeter:
    """Collector of latencies: single values since the last `take`, before it a histogram."""

    def __init__(self) -> None:
        self._recent: list[float] = []
        self._histogram = np.zeros(_BINS, np.int64)
        self._max_ms = 0.0

    def add(self, latency_ns: int) -> None:
        """Add the latency of one tick; a negative one counts as zero."""
        self._recent.append(max(latency_ns, 0) / 1e6)

    def take(self) -> TickLatency:
        """Return the statistics of the ticks since the last call, and add them to the histogram."""
        recent, self._recent = np.array(self._recent), []
        if not len(recent):
            return TickLatency()
        at = np.minimum((recent / _BIN_MS).astype(np.int64), _BINS - 1)
        np.add.at(self._histogram, at, 1)
        self._max_ms = max(self._max_ms, float(recent.max()))
        p50, p99 = np.percentile(recent, [50, 99])
        return TickLatency(len(recent), float(p50), float(p99), float(recent.max()))

    def overall(self) -> TickLatency:
        """Statistics of all ticks up to the last `take`; percentiles in 0.05 ms steps."""
        cumulated = np.cumsum(self._histogram)
        total = int(cumulated[-1])
        if not total:
            return TickLatency()
        p50, p99 = (
            float(_BIN_MS * (np.searchsorted(cumulated, q * total) + 1)) for q in (0.5, 0.99)
        )
        return TickLatency(total, min(p50, self._max_ms), min(p99, self._max_ms), self._max_ms)
