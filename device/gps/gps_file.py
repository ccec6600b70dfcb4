"""Read GPS fixes from a file: GPX, or a log of NMEA sentences."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from xml.etree import ElementTree

from device.errors import GpsError
from device.gps.fix import Fix, FixKind, fix
from device.gps.nmea import NmeaParser

# of GPX, which has elements for it
_KINDS = {
    "none": FixKind.NONE,
    "2d": FixKind.TWO_D,
    "3d": FixKind.THREE_D,
    "dgps": FixKind.DIFFERENTIAL,
}


def read_gps_file(path: Path) -> list[Fix]:
    """Read the fixes of a file in order; `t_ns` is their Unix time. Raises GpsError."""
    try:
        fixes = _gpx(path) if path.suffix.lower() == ".gpx" else _nmea(path)
    except OSError as error:
        raise GpsError(f"{path}: cannot be read ({error.strerror})") from None
    except (ElementTree.ParseError, KeyError, ValueError) as error:
        raise GpsError(f"{path}: not a GPX file ({error})") from None
    return sorted(fixes, key=lambda each: each.t_ns)


def _gpx(path: Path) -> list[Fix]:
    found = []
    for point in ElementTree.parse(path).iterfind(".//{*}trkpt"):
        text = point.findtext("{*}time", "").strip()
        if not text:
            continue
        at = datetime.fromisoformat(text)
        since = (at if at.tzinfo else at.replace(tzinfo=UTC)) - datetime(1970, 1, 1, tzinfo=UTC)
        t_ns = ((since.days * 86400 + since.seconds) * 10**6 + since.microseconds) * 1000
        height = float(point.findtext("{*}ele", "nan"))
        lla = float(point.attrib["lat"]), float(point.attrib["lon"]), height
        kind = _KINDS.get(point.findtext("{*}fix", "").strip(), FixKind.UNKNOWN)
        hdop, vdop = (float(point.findtext(f"{{*}}{name}", "nan")) for name in ("hdop", "vdop"))
        satellites = point.findtext("{*}sat")
        count = None if satellites is None else int(satellites)
        found.append(fix(t_ns, t_ns, lla, kind, None, hdop, vdop, count))
    return found


def _nmea(path: Path) -> list[Fix]:
    parser = NmeaParser()
    found = []
    with path.open("rb") as file:
        while data := file.read(1 << 16):
            found += parser.feed(data, 0)
    found += parser.flush()
    if not parser.sentences:
        raise GpsError(f"{path}: neither GPX nor NMEA: no valid sentence in it")
    dated = [each.at(each.utc_ns) for each in found if each.utc_ns is not None]
    if not dated:
        raise GpsError(f"{path}: no RMC sentence, and so no date")
    return dated
