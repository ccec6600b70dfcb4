"""Read GPS fixes from `gps.csv`, as `import` writes it, or from a GPX file."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from calm_edge.types import CalmEdgeError, Float, Int

# sigmas [m], east, north, up, of a fix that does not say how good it is
USUAL_SIGMA_M = (2.5, 2.5, 5.0)
GPS_FILE = "gps.csv"


class GpsFileError(CalmEdgeError):
    """A file of GPS fixes cannot be read."""


@dataclass(frozen=True, slots=True)
class GpsFixes:
    """Fixes in order: t_ns (M,), lla (M, 3) latitude, longitude [deg], height [m]; sigma_m (M, 3).

    dropped: number of rows without a position.
    """

    path: Path
    t_ns: Int
    lla: Float
    sigma_m: Float
    dropped: int


def read_fixes(path: Path) -> GpsFixes:
    """Read a .gpx file, or a CSV file of `import`; raises GpsFileError."""
    try:
        rows = _gpx(path) if path.suffix.lower() == ".gpx" else _csv(path)
    except OSError as error:
        raise GpsFileError(f"{path}: cannot be read ({error.strerror})") from None
    except (ElementTree.ParseError, csv.Error, KeyError, ValueError) as error:
        raise GpsFileError(
            f"{path}: not a file of GPS fixes ({error}); give a .gpx file or {GPS_FILE} of import"
        ) from None
    kept = [row for row in rows if row is not None]
    if not kept:
        raise GpsFileError(f"{path}: holds no fix with a time and a position")
    kept.sort(key=lambda row: row[0])
    values = np.array([row[1:] for row in kept], np.float64)
    times = np.array([row[0] for row in kept], np.int64)
    return GpsFixes(path, times, values[:, :3], values[:, 3:], len(rows) - len(kept))


_Row = tuple[int, float, float, float, float, float, float]


def _row(t_ns: int, lla: tuple[float, float, float], sigma: tuple[float, ...]) -> _Row | None:
    """A row of finite numbers; None without a position. An unknown height is 0, and unsure."""
    latitude, longitude, height = lla
    if not (abs(latitude) <= 90 and abs(longitude) <= 360) or (latitude == longitude == 0):
        return None
    if not np.isfinite(height):
        height, sigma = 0.0, (*sigma[:2], 1e4)
    east, north, up = sigma
    return t_ns, latitude, longitude, height, east, north, up


def _csv(path: Path) -> list[_Row | None]:
    rows: list[_Row | None] = []
    with path.open(newline="") as file:
        for row in csv.DictReader(file):
            seconds, _, rest = row["t_s"].partition(".")
            t_ns = int(seconds) * 10**9 + int((rest + "0" * 9)[:9])
            if row["status"].strip() == "-1":
                rows.append(None)
                continue
            variances = [float(row[f"covariance_{x}{x}_m2"] or 0) for x in "enu"]
            known = all(0 < v < np.inf for v in variances)
            sigma = tuple(np.sqrt(variances).tolist()) if known else USUAL_SIGMA_M
            names = "latitude_deg", "longitude_deg", "altitude_m"
            latitude, longitude, height = (float(row[name]) for name in names)
            rows.append(_row(t_ns, (latitude, longitude, height), sigma))
    return rows


def _gpx(path: Path) -> list[_Row | None]:
    rows: list[_Row | None] = []
    for point in ElementTree.parse(path).iterfind(".//{*}trkpt"):
        found = point.find("{*}time")
        if found is None or not found.text:
            rows.append(None)
            continue
        time = datetime.fromisoformat(found.text.strip())
        time = time if time.tzinfo else time.replace(tzinfo=UTC)
        since = time - datetime(1970, 1, 1, tzinfo=UTC)
        t_ns = ((since.days * 86400 + since.seconds) * 10**6 + since.microseconds) * 1000
        height = point.findtext("{*}ele", "nan")
        lla = float(point.attrib["lat"]), float(point.attrib["lon"]), float(height)
        rows.append(_row(t_ns, lla, USUAL_SIGMA_M))
    return rows
