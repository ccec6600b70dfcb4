"""The path as GPX 1.1."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from calm_edge import __version__
from calm_edge.interchange.export.base import ExportOptions, Written
from calm_edge.interchange.export.drive import ExportedDrive
from calm_edge.interchange.export.geo_track import geo_track, iso


class Gpx:
    """`track.gpx`: a track with a segment for each piece without a gap."""

    name = "gpx"
    writes = "the path on the Earth as a GPS track"

    def write(self, drive: ExportedDrive, folder: Path, options: ExportOptions) -> Written:
        """Write the path; raises InterchangeError for a drive that is not georeferenced."""
        found = geo_track(drive)
        root = Element(
            "gpx",
            xmlns="http://www.topografix.com/GPX/1/1",
            version="1.1",
            creator=f"calm-edge {__version__}",
        )
        track = SubElement(root, "trk")
        SubElement(track, "name").text = drive.path.name
        for t_ns, lla in found.pieces:
            segment = SubElement(track, "trkseg")
            for t, (latitude, longitude, height) in zip(t_ns.tolist(), lla.tolist(), strict=True):
                point = SubElement(segment, "trkpt", lat=f"{latitude:.9f}", lon=f"{longitude:.9f}")
                SubElement(point, "ele").text = f"{height:.3f}"
                if found.dated:
                    SubElement(point, "time").text = iso(t)
        tree = ElementTree.ElementTree(root)
        tree.write(folder / "track.gpx", encoding="utf-8", xml_declaration=True)
        return found.written("track.gpx")
