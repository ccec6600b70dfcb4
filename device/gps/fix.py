"""A GPS fix and its quality."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import StrEnum


class FixKind(StrEnum):
    """How a position was found; NONE: there is none."""

    NONE = "none"
    TWO_D = "2D"
    THREE_D = "3D"
    DIFFERENTIAL = "differential"
    RTK_FLOAT = "RTK float"
    RTK = "RTK"
    ESTIMATED = "estimated"
    UNKNOWN = "unknown"


# sigma [m] of one range of a satellite; times the dilution it is that of a position
RANGE_SIGMA_M = {
    FixKind.TWO_D: 5.0,
    FixKind.THREE_D: 2.5,
    FixKind.DIFFERENTIAL: 1.5,
    FixKind.RTK_FLOAT: 0.4,
    FixKind.RTK: 0.02,
    FixKind.ESTIMATED: 20.0,
    FixKind.UNKNOWN: 2.5,
}
# dilutions of a receiver that does not say its own
USUAL_HDOP, USUAL_VDOP = 1.4, 2.0
# sigma [m] of a height that is not known
NO_HEIGHT_SIGMA_M = 1e4


@dataclass(frozen=True, slots=True)
class Fix:
    """One answer of a GPS receiver, also without a position (kind NONE).

    t_ns: its arrival, on the clock of the frames. utc_ns: Unix time of the measurement by GPS, None
    if not known. lla: latitude, longitude [deg], height over the ellipsoid [m]. sigma_m: east,
    north, up. measured: the sigmas are the receiver's own, not derived from kind and dilution.
    hdop: NaN, satellites: None if not known.
    """

    t_ns: int
    utc_ns: int | None
    lla: tuple[float, float, float]
    sigma_m: tuple[float, float, float]
    kind: FixKind
    measured: bool = False
    hdop: float = math.nan
    satellites: int | None = None

    @property
    def has_position(self) -> bool:
        """Whether there is a position."""
        return self.kind is not FixKind.NONE

    def at(self, t_ns: int) -> Fix:
        """The same fix at another time of the frames' clock."""
        return replace(self, t_ns=t_ns)


def fix(
    t_ns: int,
    utc_ns: int | None,
    lla: tuple[float, float, float],
    kind: FixKind,
    sigma_m: tuple[float, float, float] | None = None,
    hdop: float = math.nan,
    vdop: float = math.nan,
    satellites: int | None = None,
) -> Fix:
    """Make a fix: no position if it is none on Earth, sigmas of its dilution if it has no own.

    An unknown height (NaN) is 0, with NO_HEIGHT_SIGMA_M. sigma_m: None or not positive: unknown.
    """
    latitude, longitude, height = lla
    on_earth = abs(latitude) <= 90 and abs(longitude) <= 360 and (latitude or longitude)
    if kind is FixKind.NONE or not on_earth:
        zero = (0.0, 0.0, 0.0)
        unknown = (NO_HEIGHT_SIGMA_M,) * 3
        return Fix(t_ns, utc_ns, zero, unknown, FixKind.NONE, False, hdop, satellites)
    measured = sigma_m is not None and all(0 < s < math.inf for s in sigma_m)
    if sigma_m is None or not measured:
        one = RANGE_SIGMA_M[kind]
        level = one * (hdop if 0 < hdop < 99 else USUAL_HDOP) / math.sqrt(2)
        sigma_m = level, level, one * (vdop if 0 < vdop < 99 else USUAL_VDOP)
    if not math.isfinite(height):
        height, sigma_m = 0.0, (*sigma_m[:2], NO_HEIGHT_SIGMA_M)
    place = (latitude, longitude, height)
    return Fix(t_ns, utc_ns, place, sigma_m, kind, measured, hdop, satellites)
