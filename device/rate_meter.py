"""Measure the frame rate of a camera: what a driver reports is only what it was asked for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from device.clock import NS_PER_S

# long enough for 10 Hz to be measured to 2 % with the stamps' jitter
PERIOD_NS = 5 * NS_PER_S
# relative deviations that are reported
TOO_SLOW, TOO_FAST = 0.85, 1.2


class RateMeter:
    """Measures the rate of one camera, once every PERIOD_NS."""

    def __init__(self) -> None:
        self._first: tuple[int, int] | None = None
        self._count = 0

    def restart(self) -> None:
        """Begin anew: the camera was opened again, or its controls were changed."""
        self._first = None

    def add(self, sequence: int, t_ns: int) -> float | None:
        """Add a frame; return the rate in Hz at the end of a period, else None.

        Frames dropped on the way count, if the sequence numbers show them: the camera exposed them.
        """
        if self._first is None:
            self._first, self._count = (sequence, t_ns), 0
            return None
        self._count += 1
        since_ns = t_ns - self._first[1]
        if since_ns < PERIOD_NS:
            return None
        exposed = max(self._count, sequence - self._first[0])
        self._first, self._count = (sequence, t_ns), 0
        return exposed * NS_PER_S / since_ns


@dataclass(frozen=True, slots=True)
class Deviation:
    """A measured rate that is wrong; the text says what to do."""

    kind: Literal["slow", "fast"]
    text: str


def deviation(hz: float, asked_hz: float, granted_hz: float) -> Deviation | None:
    """Compare a measured rate with those asked for and granted; None if it is right.

    granted_hz: as the driver reported it, 0 if it does not.
    """
    granted_hz = granted_hz or asked_hz
    if hz < TOO_SLOW * min(asked_hz, granted_hz):
        return Deviation(
            "slow",
            f"delivers {hz:.1f} Hz, not {granted_hz:g}; automatic exposure slows a camera in the "
            f"dark: set capture.exposure_us to less than {1e6 / granted_hz:.0f}, "
            "or capture.rate_hz to the rate it has",
        )
    if hz > TOO_FAST * max(asked_hz, granted_hz):
        return Deviation(
            "fast",
            f"delivers {hz:.1f} Hz, not {granted_hz:g}: it ignores capture.rate_hz; every frame "
            "is recorded, which costs disk space and computing time",
        )
    return None
