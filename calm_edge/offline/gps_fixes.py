"""GPS fixes of a drive: those of its recording, or of a file."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calm_edge.recording import schema
from calm_edge.recording.reader import Recording
from calm_edge.types import CalmEdgeError, Float, Int
from device.errors import GpsError
from device.gps.fix import Fix, FixKind, fix
from device.gps.gps_file import read_gps_file

# as imports of version 0.1.0 wrote it beside the recording
GPS_FILE = "gps.csv"


class GpsFileError(CalmEdgeError):
    """A file of GPS fixes cannot be read."""


@dataclass(frozen=True, slots=True)
class GpsFixes:
    """Fixes in order: t_ns (M,), lla (M, 3) latitude, longitude [deg], height [m]; sigma_m (M, 3).

    path: file or recording. dropped: number of fixes without a position.
    """

    path: Path
    t_ns: Int
    lla: Float
    sigma_m: Float
    dropped: int

    def within(self, first_ns: int, last_ns: int) -> GpsFixes | None:
        """The fixes of these times, both included; None without any."""
        kept = (self.t_ns >= first_ns) & (self.t_ns <= last_ns)
        if not kept.any():
            return None
        return GpsFixes(self.path, self.t_ns[kept], self.lla[kept], self.sigma_m[kept], 0)


def fixes_of(recording: Recording, file: Path | None) -> GpsFixes | None:
    """Fixes of a file if one is given, else of the recording; None if it holds none.

    Times are the user's stamps. Raises GpsFileError, RecordingError.
    """
    beside = recording.path / GPS_FILE
    if file is not None or beside.is_file():
        return read_fixes(file or beside)
    answers = recording.count(schema.GPS_QUALITY)
    found = list(recording.fixes())
    if not found:
        return None
    origin_ns = recording.origin_ns
    return _table(recording.path, (each.at(each.t_ns - origin_ns) for each in found), answers)


def read_fixes(path: Path) -> GpsFixes:
    """Read a file: GPX, NMEA, or the CSV of an earlier import; raises GpsFileError."""
    try:
        found = _csv(path) if path.suffix.lower() == ".csv" else read_gps_file(path)
    except GpsError as error:
        raise GpsFileError(f"{error}; give GPX or NMEA") from None
    except OSError as error:
        raise GpsFileError(f"{path}: cannot be read ({error.strerror})") from None
    except (csv.Error, KeyError, ValueError) as error:
        raise GpsFileError(f"{path}: not a table of fixes ({error}); give GPX or NMEA") from None
    kept = [each for each in found if each.has_position]
    if not kept:
        raise GpsFileError(f"{path}: holds no fix with a time and a position")
    return _table(path, kept, len(found))


def _table(path: Path, fixes: Iterable[Fix], answers: int) -> GpsFixes:
    kept = sorted(fixes, key=lambda each: each.t_ns)
    t_ns = np.array([each.t_ns for each in kept], np.int64)
    lla, sigma_m = (
        np.array([getattr(each, name) for each in kept], np.float64) for name in ("lla", "sigma_m")
    )
    return GpsFixes(path, t_ns, lla, sigma_m, answers - len(kept))


def _csv(path: Path) -> list[Fix]:
    found = []
    with path.open(newline="") as file:
        for row in csv.DictReader(file):
            seconds, _, rest = row["t_s"].partition(".")
            t_ns = int(seconds) * 10**9 + int((rest + "0" * 9)[:9])
            none = row["status"].strip() == "-1"
            variances = [float(row[f"covariance_{x}{x}_m2"] or 0) for x in "enu"]
            known = all(0 < v < np.inf for v in variances)
            east, north, up = np.sqrt(variances).tolist() if known else (0.0, 0.0, 0.0)
            names = "latitude_deg", "longitude_deg", "altitude_m"
            latitude, longitude, height = (float(row[name]) for name in names)
            kind = FixKind.NONE if none else FixKind.UNKNOWN
            sigma = (east, north, up) if known else None
            found.append(fix(t_ns, None, (latitude, longitude, height), kind, sigma))
    return found
