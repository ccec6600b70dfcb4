"""Processor and wall time of stages."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Measured:
    """A stage: mean processor and wall time over n runs; load: load average of the machine.

    paper_s, target_s: None where there is none. share: runs per sub-map in the correction core
    (without the test bank).
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
    """Sums the time of all runs of one stage."""

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
        """Add a run timed elsewhere, of `things` items."""
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
        """Means over the runs."""
        n, load = max(self._n, 1), os.getloadavg()[0]
        cpu_s, wall_s = self.cpu_s / n, self.wall_s / n
        return Measured(name, paper_s, target_s, cpu_s, wall_s, self._n, load, share)
