"""Sensors beside the cameras, whose samples are recorded: receivers, and stored samples."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Protocol

from calm_edge.recording.sensors import Sample


class Sensor(Protocol):
    """A source of samples that never blocks whoever takes them."""

    def start(self) -> None:
        """Begin to receive."""
        ...

    def take(self, now_ns: int) -> Sequence[Sample]:
        """Return the samples since the last call, up to now_ns on the clock of the frames."""
        ...

    @property
    def fault(self) -> str:
        """What is wrong with the sensor; empty if nothing is."""
        ...

    def stop(self) -> None:
        """Stop receiving."""
        ...


class StoredSamples:
    """Samples of a replay in order of time, each given at its time."""

    fault = ""

    def __init__(self, samples: Iterable[Sample]) -> None:
        self._samples = iter(samples)
        self._next = next(self._samples, None)

    def start(self) -> None:
        """Nothing to open."""

    def take(self, now_ns: int) -> list[Sample]:
        """Return the samples since the last call, up to now_ns."""
        found = []
        while self._next is not None and self._next.t_ns <= now_ns:
            found.append(self._next)
            self._next = next(self._samples, None)
        return found

    def stop(self) -> None:
        """Nothing to close."""
