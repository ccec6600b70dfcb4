"""The primary's path on the Earth, for formats of geographic programs."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import numpy as np

from calm_edge.interchange import InterchangeError
from calm_edge.interchange.export.base import Written
from calm_edge.interchange.export.drive import ExportedDrive
from calm_edge.interchange.export.georeference import Georeference
from calm_edge.recording.time_base import DATED_NS
from calm_edge.types import Float, Int
from device.frame import Eye

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


@dataclass(frozen=True, slots=True)
class GeoTrack:
    """Frames with poses in pieces without a gap: t_ns (N,) Unix time, lla (N, 3) as WGS 84.

    dated: the stamps are dates. left_out: number of frames without a pose.
    """

    pieces: tuple[tuple[Int, Float], ...]
    dated: bool
    left_out: int
    place: Georeference

    @property
    def count(self) -> int:
        """Number of positions."""
        return sum(len(t) for t, _ in self.pieces)

    def written(self, name: str) -> Written:
        """What an exporter wrote to the file `name`."""
        wrote = f"{name}: {self.count} positions of the primary in {len(self.pieces)} pieces"
        left_out = [f"{self.left_out} frames: without a pose"] if self.left_out else []
        if not self.dated:
            left_out.append("times: the stamps are no dates")
        return Written((wrote,), self.place.described(), (*left_out, "orientations"))


def geo_track(drive: ExportedDrive) -> GeoTrack:
    """Path of the primary; raises InterchangeError for a drive that is not georeferenced."""
    if drive.place is None:
        raise InterchangeError(
            f"{drive.path}: not georeferenced; make a map of a drive with GPS fixes by calm-edge "
            "map (--gps FILE), and give its folder"
        )
    poses = drive.frame_poses()[Eye.PRIMARY]
    known = np.flatnonzero(poses.known)
    t_ns = drive.own_ns(poses.t_ns[known])
    lla = drive.place.geodetic(poses.T_w_c[known, :3, 3])
    gaps = np.flatnonzero(np.diff(known) > 1) + 1
    pieces = tuple(zip(np.split(t_ns, gaps), np.split(lla, gaps), strict=True))
    dated = bool(len(t_ns) and t_ns[0] >= DATED_NS)
    return GeoTrack(pieces, dated, len(poses.known) - len(known), drive.place)


def iso(t_ns: int) -> str:
    """Unix time as ISO 8601, to the microsecond."""
    return (_EPOCH + timedelta(microseconds=t_ns // 1000)).isoformat().replace("+00:00", "Z")
