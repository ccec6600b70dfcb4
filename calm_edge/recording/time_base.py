"""Relate the times of messages to the user's stamps and to Unix time.

`t_ns` of a live run is host-monotonic, that of a replay the stamp of its source plus an origin.
Viewers need Unix time: MCAP's publish_time is t_ns, its log_time the arrival at the recorder, both
plus `epoch_ns`. Stamps within messages are t_ns - `origin_ns`.
"""

from __future__ import annotations

import ctypes
import re
import time
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from calm_edge.recording import RecordingError

# keys of the session's metadata
ORIGIN_KEY, EPOCH_KEY, CLOCK_KEY = "origin_ns", "epoch_ns", "clock"

# 2000-01-01 UTC. Earlier stamps are no dates; in lockstep they are counted from here.
DATED_NS = 946_684_800 * 10**9
# returned by ntp_adjtime of a clock that nothing synchronises
_TIME_ERROR = 5
_INTEGER = re.compile(r"-?\d{1,19}")


class WallClock(StrEnum):
    """Where the Unix time of a recording comes from; the values are those of the metadata.

    UNSYNCHRONISED: the host's clock, not set by NTP or GPS: its date may be wrong. SOURCE: the
    stamps of a replay are dates. RUN: they are not, and count from the start of the run. UNDATED:
    they are not, and count from 2000-01-01, since a lockstep recording does not depend on the day.
    """

    SYNCHRONISED = "synchronised"
    UNSYNCHRONISED = "unsynchronised"
    SOURCE = "stamps of the source"
    RUN = "start of the run"
    UNDATED = "none: stamps counted from 2000-01-01"


@dataclass(frozen=True, slots=True)
class TimeBase:
    """Offsets of t_ns: the user's stamp is t_ns - origin_ns, Unix time is t_ns + epoch_ns."""

    origin_ns: int = 0
    epoch_ns: int = 0
    clock: WallClock = WallClock.UNDATED

    def metadata(self) -> dict[str, str]:
        """Entries of the session's metadata."""
        return {
            ORIGIN_KEY: str(self.origin_ns),
            EPOCH_KEY: str(self.epoch_ns),
            CLOCK_KEY: self.clock.value,
        }


def live() -> TimeBase:
    """Time base of cameras: t_ns is host-monotonic, stamps are in Unix time."""
    epoch_ns = time.time_ns() - time.monotonic_ns()
    return TimeBase(-epoch_ns, epoch_ns, _HOST[synchronised()])


def lift_ns(first_ns: int) -> int:
    """What to add to stamps of a source for the first, first_ns, to be positive; mostly 0."""
    return 0 if first_ns > 0 else 10**9 - first_ns


_HOST = {True: WallClock.SYNCHRONISED, False: WallClock.UNSYNCHRONISED}


def of_stamps(origin_ns: int, first_ns: int, *, lockstep: bool) -> TimeBase:
    """Time base of stored frames. first_ns: t_ns of the first, which has origin_ns added.

    Raises RecordingError for stamps so far below 0 that a recording cannot hold their time.
    """
    if first_ns - origin_ns < -DATED_NS:
        raise RecordingError(
            f"the first stamp is {(first_ns - origin_ns) / 1e9:.0f} s, before {-DATED_NS // 10**9} "
            "s, which a recording cannot hold; add a constant to all times"
        )
    if first_ns - origin_ns >= DATED_NS:
        return TimeBase(origin_ns, -origin_ns, WallClock.SOURCE)
    if lockstep:
        return TimeBase(origin_ns, DATED_NS - origin_ns, WallClock.UNDATED)
    return TimeBase(origin_ns, time.time_ns() - first_ns, WallClock.RUN)


def integer(values: Mapping[str, str], key: str) -> int | None:
    """Value of a key that holds an integer; None if it is absent or holds something else."""
    text = values.get(key, "")
    return int(text) if _INTEGER.fullmatch(text) else None


def synchronised() -> bool:
    """Whether the kernel regards the host's clock as synchronised (ntp_adjtime(3))."""
    # struct timex, modes = 0: nothing is changed
    timex = ctypes.create_string_buffer(512)
    try:
        state = int(ctypes.CDLL(None).ntp_adjtime(timex))
    except (AttributeError, OSError):
        return False
    return 0 <= state < _TIME_ERROR
