"""Measure how long the stages of a window take."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter


@contextmanager
def timed(stage_ms: dict[str, float], stage: str) -> Iterator[None]:
    """Enter the time of the block into `stage_ms`, unless the block raises."""
    start = perf_counter()
    yield
    stage_ms[stage] = (perf_counter() - start) * 1e3
