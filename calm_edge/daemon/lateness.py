"""How late ticks came: of the last second, and of the whole run in bounded memory."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

_BIN_MS = 0.05
_BINS = 40_000


@dataclass(frozen=True, slots=True)
class Lateness:
    """Milliseconds behind the deadline; zeros where there was no tick."""

    ticks: int = 0
    p50_ms: float = 0.0
    p99_ms: float = 0.0
    max_ms: float = 0.0


class LatenessMeter:
    """Owner of the ticks since the last `take`, and of a histogram of all: 2 s."""

    def __init__(self) -> None:
        self._recent: list[float] = []
        self._histogram = np.zeros(_BINS, np.int64)
        self._max_ms = 0.0

    def note(self, lateness_ns: int) -> None:
        """One tick came so late; early is zero."""
        self._recent.append(max(lateness_ns, 0) / 1e6)

    def take(self) -> Lateness:
        """Of the ticks since the last call."""
        recent, self._recent = np.array(self._recent), []
        if not len(recent):
            return Lateness()
        at = np.minimum((recent / _BIN_MS).astype(np.int64), _BINS - 1)
        np.add.at(self._histogram, at, 1)
        self._max_ms = max(self._max_ms, float(recent.max()))
        p50, p99 = np.percentile(recent, [50, 99])
        return Lateness(len(recent), float(p50), float(p99), float(recent.max()))

    def overall(self) -> Lateness:
        """Of every tick that was taken; percentiles rounded up to the histogram's step."""
        cumulated = np.cumsum(self._histogram)
        total = int(cumulated[-1])
        if not total:
            return Lateness()
        p50, p99 = (
            float(_BIN_MS * (np.searchsorted(cumulated, q * total) + 1)) for q in (0.5, 0.99)
        )
        return Lateness(total, min(p50, self._max_ms), min(p99, self._max_ms), self._max_ms)
