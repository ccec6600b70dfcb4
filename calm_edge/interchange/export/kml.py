"""The path as KML 2.2."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from calm_edge.interchange.export.base import ExportOptions, Written
from calm_edge.interchange.export.drive import ExportedDrive
from calm_edge.interchange.export.geo_track import geo_track, iso


class Kml:
    """`track.kml`: a line for each piece without a gap, clamped to the ground.

    KML's heights are over the sea; those of GPS are not, so that the line would hover.
    """

    name = "kml"
    writes = "the path on the Earth for Google Earth and others"

    def write(self, drive: ExportedDrive, folder: Path, options: ExportOptions) -> Written:
        """Write the path; raises InterchangeError for a drive that is not georeferenced."""
        found = geo_track(drive)
        root = Element("kml", xmlns="http://www.opengis.net/kml/2.2")
        document = SubElement(root, "Document")
        SubElement(document, "name").text = drive.path.name
        for t_ns, lla in found.pieces:
            placemark = SubElement(document, "Placemark")
            if found.dated:
                span = SubElement(placemark, "TimeSpan")
                SubElement(span, "begin").text = iso(int(t_ns[0]))
                SubElement(span, "end").text = iso(int(t_ns[-1]))
            line = SubElement(placemark, "LineString")
            SubElement(line, "tessellate").text = "1"
            SubElement(line, "altitudeMode").text = "clampToGround"
            SubElement(line, "coordinates").text = " ".join(
                f"{longitude:.9f},{latitude:.9f},{height:.3f}"
                for latitude, longitude, height in lla.tolist()
            )
        tree = ElementTree.ElementTree(root)
        tree.write(folder / "track.kml", encoding="utf-8", xml_declaration=True)
        return found.written("track.kml")
