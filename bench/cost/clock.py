"""The seconds a stage takes, of the processor and of the clock."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Measured:
    """A stage: mean seconds of the processor and of the clock over n runs; load: the machine's.

    paper_s, target_s: None where there is none. share: how often a sub-map pays for it in the
    correction core, the test bank excluded.
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
    """Owns the seconds of all runs of one stage."""

    def __init__(self) -> None:
        self.cpu_s = self.wall_s = 0.0
        self._n = 0

    def run(self, work: Callable[[], T]) -> T:
        """What `work` gives; its time is added."""
        wall, cpu = time.perf_counter(), time.process_time()
        made = work()
        self.add(time.process_time() - cpu, time.perf_counter() - wall)
        return made

    def add(self, cpu_s: float, wall_s: float, things: int = 1) -> None:
        """A run that was timed elsewhere, of so many things."""
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
        """The mean of the runs."""
        n, load = max(self._n, 1), os.getloadavg()[0]
        cpu_s, wall_s = self.cpu_s / n, self.wall_s / n
        return Measured(name, paper_s, target_s, cpu_s, wall_s, self._n, load, share)
