"""The path as GeoJSON (RFC 7946)."""

from __future__ import annotations

import json
from pathlib import Path

from calm_edge.interchange.export.base import ExportOptions, Written
from calm_edge.interchange.export.drive import ExportedDrive
from calm_edge.interchange.export.geo_track import geo_track, iso


class GeoJson:
    """`track.geojson`: a MultiLineString; its times are in the property `coordTimes`."""

    name = "geojson"
    writes = "the path on the Earth for geographic programs"

    def write(self, drive: ExportedDrive, folder: Path, options: ExportOptions) -> Written:
        """Write the path; raises InterchangeError for a drive that is not georeferenced."""
        track = geo_track(drive)
        lines = [[_position(*place) for place in lla.tolist()] for _, lla in track.pieces]
        latitude, longitude, height = track.place.origin.tolist()
        properties: dict[str, object] = {
            "name": drive.path.name,
            "origin": {"latitude": latitude, "longitude": longitude, "height_m": height},
            "residual_rms_m": track.place.residual_m,
        }
        if track.dated:
            properties["coordTimes"] = [[iso(t) for t in t_ns.tolist()] for t_ns, _ in track.pieces]
        feature = {
            "type": "Feature",
            "properties": properties,
            "geometry": {"type": "MultiLineString", "coordinates": lines},
        }
        content = {"type": "FeatureCollection", "features": [feature]}
        (folder / "track.geojson").write_text(json.dumps(content) + "\n")
        return track.written("track.geojson")


def _position(latitude: float, longitude: float, height: float) -> list[float]:
    return [round(longitude, 9), round(latitude, 9), round(height, 3)]
