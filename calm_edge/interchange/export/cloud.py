"""Point clouds of a map: levelled, Z up; as PLY with normals, or as LAZ."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from calm_edge import __version__
from calm_edge.interchange import InterchangeError
from calm_edge.interchange.export.base import ExportOptions, Written
from calm_edge.interchange.export.drive import ExportedDrive
from calm_edge.interchange.export.level import Level, best_level
from calm_edge.interchange.export.utm import utm
from calm_edge.mapping.cloud_file import count_points, read_tiles
from calm_edge.types import Float, Float32, MapTile

# points that are in memory at once; a tile's normals are of its own points
TILE = 200_000
# neighbours from which a normal is estimated
NEIGHBOURS = 12
VERTEX = np.dtype([("p", "<f4", 3), ("n", "<f4", 3), ("color", "u1", 3)])
LAS_STEP = 1e-3


@dataclass(frozen=True, slots=True)
class LevelledCloud:
    """The cloud of a map in the levelled frame. path_l: (K, 3) positions of the camera."""

    file: Path
    count: int
    level: Level
    path_l: Float

    def tiles(self) -> Iterator[MapTile]:
        """At most TILE points at a time; `points_w` is in the levelled frame."""
        R = self.level.R_l_w.astype(np.float32)
        for tile in read_tiles(self.file, TILE):
            yield MapTile(tile.points_w @ R.T, tile.color)


def levelled(drive: ExportedDrive) -> LevelledCloud:
    """Open the cloud of a map; raises InterchangeError for a drive without one."""
    if drive.cloud is None:
        raise InterchangeError(
            f"{drive.path}: has no cloud; make one by calm-edge map, and give its folder"
        )
    count = count_points(drive.cloud)
    if not count:
        raise InterchangeError(f"{drive.cloud}: holds no point; nothing to export")
    found = level_of(drive)
    path_l = drive.keyframes.T_w_c[:, :3, 3] @ found.R_l_w.T
    return LevelledCloud(drive.cloud, count, found, path_l)


def level_of(drive: ExportedDrive) -> Level:
    """Level of a drive, by its path or by GPS heights."""
    place = drive.place
    R_up_w, sigma_deg = (None, np.inf) if place is None else (place.R_enu_w, place.tilt_sigma_deg)
    return best_level(drive.keyframes.T_w_c, drive.spacing, R_up_w, sigma_deg)


def described(drive: ExportedDrive, cloud: LevelledCloud) -> tuple[str, ...]:
    """Lines on the frame, unit and level of a cloud."""
    return (
        "x ahead at the start, y left, z up; the origin is the camera at the first keyframe",
        f"lengths in {drive.unit}",
        cloud.level.described(),
    )


class Ply:
    """`map.ply`: binary, with normals and colours; its header names frame, unit and level."""

    name = "ply"
    writes = "point cloud with normals"

    def write(self, drive: ExportedDrive, folder: Path, options: ExportOptions) -> Written:
        """Write the cloud; raises InterchangeError, CloudError."""
        cloud = levelled(drive)
        lines = described(drive, cloud)
        names = [f"property float {a}" for a in ("x", "y", "z", "nx", "ny", "nz")]
        names += [f"property uchar {c}" for c in ("red", "green", "blue")]
        comments = [f"comment {line}" for line in (f"calm-edge {__version__}", *lines)]
        head = ["ply", "format binary_little_endian 1.0", *comments]
        head += [f"element vertex {cloud.count}", *names, "end_header", ""]
        path = cKDTree(cloud.path_l)
        with (folder / "map.ply").open("wb") as file:
            file.write("\n".join(head).encode("ascii", "replace"))
            for tile in cloud.tiles():
                vertices = np.empty(len(tile.points_w), VERTEX)
                vertices["p"], vertices["color"] = tile.points_w, tile.color
                vertices["n"] = normals(tile.points_w, cloud.path_l, path)
                file.write(vertices.tobytes())
        wrote = f"map.ply: {cloud.count} points with colours and normals"
        note = f"normals of {NEIGHBOURS} neighbours, towards the nearest keyframe"
        return Written((wrote,), (*lines, note), ("confidences: the map has none",))


class Laz:
    """`map.laz`: LAZ 1.4 with colours; of a georeferenced map in UTM, else levelled."""

    name = "laz"
    writes = "point cloud for geographic information systems"

    def write(self, drive: ExportedDrive, folder: Path, options: ExportOptions) -> Written:
        """Write the cloud; raises InterchangeError, CloudError."""
        laspy = require_laspy()
        cloud = levelled(drive)
        header = laspy.LasHeader(point_format=7, version="1.4")
        header.scales, header.offsets = np.full(3, LAS_STEP), np.zeros(3)
        header.generating_software = f"calm-edge {__version__}"
        header.global_encoding.wkt = True
        left_out: tuple[str, ...] = ()
        if drive.place is None:
            lines, convert = described(drive, cloud), None
            left_out = ("the coordinate reference system: the map is not georeferenced",)
        else:
            zone = utm(drive.place)
            lines, convert = (f"{zone.name}, in metres", *drive.place.described()), zone.convert
            header.offsets = np.floor(convert(drive.keyframes.T_w_c[:1, :3, 3])[0])
            header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(zone.wkt))
        text = "\n".join(lines).encode("ascii", "replace")
        header.vlrs.append(laspy.VLR("LASF_Spec", 3, "text area description", text))
        with laspy.open(folder / "map.laz", "w", header=header, do_compress=True) as file:
            for tile in cloud.tiles() if convert is None else read_tiles(cloud.file, TILE):
                points = tile.points_w.astype(np.float64)
                record = laspy.ScaleAwarePointRecord.zeros(len(points), header=header)
                record.x, record.y, record.z = (points if convert is None else convert(points)).T
                # 16 bits a colour
                colors = tile.color.T.astype(np.uint16) * 257
                record.red, record.green, record.blue = colors
                record.return_number[:] = record.number_of_returns[:] = 1
                file.write_points(record)
        return Written((f"map.laz: {cloud.count} points with colours",), lines, left_out)


def normals(points: Float32, path: Float, tree: cKDTree) -> Float32:
    """Unit normals (P, 3) of points (P, 3), towards the nearest position of path (K, 3).

    tree: of the path. A point without three neighbours has the direction to the camera.
    """
    p = points.astype(np.float64)
    to_camera = path[tree.query(p)[1]] - p
    k = min(NEIGHBOURS, len(p))
    if k < 3:
        n = to_camera
    else:
        own = cKDTree(p)
        # in the order of the tree, neighbours lie near in memory: a third of the time
        near = np.empty((len(p), k), np.intp)
        near[own.indices] = own.query(p[own.indices], k)[1]
        around = p[near]
        around -= around.mean(1, keepdims=True)
        n = np.linalg.eigh(np.swapaxes(around, 1, 2) @ around)[1][:, :, 0]
    n = n * np.where((n * to_camera).sum(1) < 0, -1.0, 1.0)[:, None]
    length = np.linalg.norm(n, axis=1, keepdims=True)
    return np.asarray(np.where(length > 0, n / np.maximum(length, 1e-12), [0, 0, 1]), np.float32)


def require_laspy() -> Any:
    """Import laspy with its compressor; raises InterchangeError with the remedy."""
    try:
        import laspy
        import lazrs  # noqa: F401
    except ImportError:
        raise InterchangeError(
            "laspy: not installed; LAZ needs it (pip install 'calm-edge[laz]')"
        ) from None
    return laspy
