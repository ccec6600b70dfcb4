"""Coordinates of geographic programs: the UTM zone of a map, by PROJ."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from calm_edge.interchange import InterchangeError
from calm_edge.interchange.export.georeference import Georeference
from calm_edge.types import Float


@dataclass(frozen=True, slots=True)
class Utm:
    """UTM zone of WGS 84. wkt: the coordinate reference system, as LAS stores it (WKT 1)."""

    code: int
    wkt: str
    place: Georeference
    transformer: Any

    @property
    def name(self) -> str:
        """The zone in words."""
        return f"EPSG:{self.code}, UTM zone {self.code % 100}{'NS'[self.code >= 32700]}"

    def convert(self, p_w: Float) -> Float:
        """Convert points (N, 3) of the world to easting, northing, ellipsoidal height [m]."""
        lla = self.place.geodetic(p_w)
        east, north = self.transformer.transform(lla[:, 1], lla[:, 0])
        return np.stack([east, north, lla[:, 2]], axis=1)


def utm(place: Georeference) -> Utm:
    """Zone of a map's origin; raises InterchangeError without pyproj."""
    try:
        import pyproj
    except ImportError:
        raise InterchangeError(
            "pyproj: not installed; coordinates of a georeferenced map need it "
            "(pip install 'calm-edge[geo]')"
        ) from None
    latitude, longitude = place.origin[:2].tolist()
    zone = int((longitude + 180) % 360 // 6) + 1
    code = (32700 if latitude < 0 else 32600) + zone
    system = pyproj.CRS.from_epsg(code)
    transformer = pyproj.Transformer.from_crs(4326, system, always_xy=True)
    return Utm(code, system.to_wkt("WKT1_GDAL"), place, transformer)
