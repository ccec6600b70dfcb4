"""Stopwatch of processor and wall time."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Measured:
    """Mean processor and wall time of one stage over n runs.

    paper_s, target_s: time in the paper, and the required one; None if there is none. load: load
    average of the machine. share: runs of the stage per sub-map, its weight in the table row
    `correction core, test bank excluded`; 0 if it is left out there. That row sums focal search,
    correction, placement and mapping, but not the matching of pictures for the focal search.
    """

    name: str
    paper_s: float | None
    target_s: float | None
    cpu_s: float
    wall_s: float
    n: int
    load: float
    share: float = 0.0


class Clock:
    """Accumulates the time of all runs of one stage."""

    def __init__(self) -> None:
        self.cpu_s = self.wall_s = 0.0
        self._n = 0

    def run(self, work: Callable[[], T]) -> T:
        """Run `work`, add its time and return its result."""
        wall, cpu = time.perf_counter(), time.process_time()
        made = work()
        self.add(time.process_time() - cpu, time.perf_counter() - wall)
        return made

    def add(self, cpu_s: float, wall_s: float, things: int = 1) -> None:
        """Add a time measured by the caller, in which `things` items were processed."""
        self.cpu_s += cpu_s
        self.wall_s += wall_s
        self._n += things

    def measured(
        self,
        name: str,
        paper_s: float | None = None,
        target_s: float | None = None,
        share: float = 0.0,
    ) -> Measured:
        """Return the mean times of the runs; the arguments are the fields of Measured."""
        n, load = max(self._n, 1), os.getloadavg()[0]
        cpu_s, wall_s = self.cpu_s / n, self.wall_s / n
        return Measured(name, paper_s, target_s, cpu_s, wall_s, self._n, load, share)
