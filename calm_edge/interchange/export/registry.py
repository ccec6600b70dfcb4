"""The table of export formats."""

from __future__ import annotations

from calm_edge.interchange.export.base import Exporter
from calm_edge.interchange.export.cloud import Laz, Ply
from calm_edge.interchange.export.colmap import Colmap
from calm_edge.interchange.export.geojson import GeoJson
from calm_edge.interchange.export.gpx import Gpx
from calm_edge.interchange.export.kitti import Kitti
from calm_edge.interchange.export.kml import Kml
from calm_edge.interchange.export.pictures import Pictures
from calm_edge.interchange.export.ros2 import Ros2
from calm_edge.interchange.export.table import Table
from calm_edge.interchange.export.transforms import Transforms
from calm_edge.interchange.export.tum import Tum

EXPORTERS: dict[str, Exporter] = {
    each.name: each
    for each in (
        Tum(),
        Kitti(),
        Table(),
        Colmap(),
        Transforms(),
        Ply(),
        Laz(),
        Ros2(),
        GeoJson(),
        Gpx(),
        Kml(),
        Pictures(),
    )
}
