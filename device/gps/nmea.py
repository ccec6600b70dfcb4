"""Read NMEA 0183 sentences of a GPS receiver: GGA and RMC, and GSA and GST for the quality."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC, date, datetime, time, timedelta
from typing import Any

import pynmea2

from device.gps.fix import Fix, FixKind, fix

# the standard allows 82
LONGEST_LINE = 200
# GGA's quality
_KINDS = {
    0: FixKind.NONE,
    1: FixKind.THREE_D,
    2: FixKind.DIFFERENTIAL,
    4: FixKind.RTK,
    5: FixKind.RTK_FLOAT,
    6: FixKind.ESTIMATED,
}
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


@dataclass(slots=True)
class _Epoch:
    """Sentences of one measurement, by their type. t_ns: arrival of the first one."""

    t_ns: int
    time: time
    sentences: dict[str, Any] = field(default_factory=dict)


class NmeaParser:
    """Parser of a stream of bytes; what is not a valid sentence is skipped and counted.

    A fix is complete when a sentence of the next measurement arrives, or at `flush`.
    """

    def __init__(self) -> None:
        self.sentences = self.skipped = 0
        self._line = bytearray()
        self._line_ns = 0
        self._epoch: _Epoch | None = None
        self._utc: datetime | None = None

    def feed(self, data: bytes, now_ns: int) -> list[Fix]:
        """Take bytes that arrived at now_ns; return the fixes that are complete."""
        found = []
        for line in data.splitlines(keepends=True):
            if not self._line:
                self._line_ns = now_ns
            self._line += line
            if line.endswith((b"\n", b"\r")):
                found += self._sentence(bytes(self._line).strip(), self._line_ns)
                self._line.clear()
            elif len(self._line) > LONGEST_LINE:
                self.skipped += 1
                self._line.clear()
        return found

    def flush(self) -> list[Fix]:
        """Return the last fix, if there is one."""
        return list(self._complete())

    def _sentence(self, line: bytes, now_ns: int) -> list[Fix]:
        if not line:
            return []
        try:
            # a receiver's log may have a time or a name before the sentence
            text = line[max(0, line.find(b"$")) :].decode("ascii")
            message = pynmea2.parse(text, check=True)
        except (pynmea2.ParseError, ValueError):
            self.skipped += 1
            return []
        self.sentences += 1
        kind = getattr(message, "sentence_type", "")
        if kind not in ("GGA", "RMC", "GSA", "GST"):
            return []
        return list(self._take(kind, message, now_ns))

    def _take(self, kind: str, message: Any, now_ns: int) -> Iterator[Fix]:
        at = getattr(message, "timestamp", None)
        if not isinstance(at, time):
            # of the measurement before it, as GSA always is
            if self._epoch is not None:
                self._epoch.sentences.setdefault(kind, message)
            return
        if self._epoch is None or at != self._epoch.time:
            yield from self._complete()
            self._epoch = _Epoch(now_ns, at)
        self._epoch.sentences[kind] = message

    def _complete(self) -> Iterator[Fix]:
        epoch, self._epoch = self._epoch, None
        if epoch is None:
            return
        gga, rmc = epoch.sentences.get("GGA"), epoch.sentences.get("RMC")
        if gga is None and rmc is None:
            return
        gsa, gst = epoch.sentences.get("GSA"), epoch.sentences.get("GST")
        utc_ns = self._dated(epoch.time, getattr(rmc, "datestamp", None))
        satellites = None
        height = math.nan
        if gga is not None:
            kind = _KINDS.get(int(_number(gga.gps_qual)), FixKind.UNKNOWN)
            height = _number(gga.altitude) + _number(gga.geo_sep, 0.0)
            satellites = int(_number(gga.num_sats, 0.0))
        else:
            assert rmc is not None
            kind = FixKind.UNKNOWN if rmc.status == "A" else FixKind.NONE
        hdop = _number(gga.horizontal_dil) if gga is not None else math.nan
        vdop, sigma_m = math.nan, None
        if gsa is not None:
            vdop = _number(gsa.vdop)
            hdop = hdop if math.isfinite(hdop) else _number(gsa.hdop)
            if str(gsa.mode_fix_type) == "2" and kind is FixKind.THREE_D:
                kind = FixKind.TWO_D
        if gst is not None:
            east, north = _number(gst.std_dev_longitude), _number(gst.std_dev_latitude)
            sigma_m = (east, north, _number(gst.std_dev_altitude))
        place: Any = gga if gga is not None else rmc
        lla = math.nan, math.nan, math.nan
        if kind is not FixKind.NONE and place.lat and place.lon:
            lla = place.latitude, place.longitude, height
        yield fix(epoch.t_ns, utc_ns, lla, kind, sigma_m, hdop, vdop, satellites)

    def _dated(self, at: time, day: date | None) -> int | None:
        """Unix time [ns] of a time of day; without a date, the nearest to the time before."""
        before = self._utc
        if day is not None:
            utc = datetime.combine(day, at.replace(tzinfo=UTC))
        elif before is not None:
            same = datetime.combine(before.date(), at.replace(tzinfo=UTC))
            days = (same + timedelta(days=k) for k in (-1, 0, 1))
            utc = min(days, key=lambda each: abs(each - before))
        else:
            return None
        self._utc = utc
        since = utc - _EPOCH
        return ((since.days * 86400 + since.seconds) * 10**6 + since.microseconds) * 1000


def _number(value: Any, absent: float = math.nan) -> float:
    try:
        return float(value)
    except (TypeError, ValueError):
        return absent
