"""KITTI raw: `DATE/DATE_drive_NNNN_{sync,extract}/{image_00 ...,oxts}` and `DATE/calib_*.txt`.

The pictures of `sync` are rectified, those of `extract` are not. Uses the colour cameras (02, 03)
if their pictures exist, else the grey ones. Each picture has its camera's own stamp. True poses are
those of the GPS and IMU (`oxts`), in the Mercator projection of the development kit.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from calm_edge.geometry import se3
from calm_edge.interchange.base import Imported, ImportOptions
from calm_edge.interchange.calibration.calibration import Calibration
from calm_edge.interchange.calibration.opencv import distorted_camera
from calm_edge.interchange.kitti_odometry import COLOUR, GREY, rectified_pair
from calm_edge.interchange.published import (
    DatasetError,
    Published,
    dated,
    entry,
    folder,
    imported,
    keyed,
    lines,
    numbers,
    pngs,
    projection,
    size,
)
from calm_edge.types import Float, Int

EARTH_M = 6378137.0
CAMERAS = "calib_cam_to_cam.txt"


def read(place: Path) -> Published:
    """Read the folder of a drive; raises DatasetError."""
    pair = COLOUR if (place / f"image_0{COLOUR[0]}").is_dir() else GREY
    files, stamps, dropped = [], [], []
    for camera in pair:
        eye = folder(place / f"image_0{camera}", "data and timestamps.txt")
        found, t_ns = (
            pngs(eye / "data", "pictures 0000000000.png ..."),
            dated(eye / "timestamps.txt"),
        )
        rows = _rows(found, len(t_ns), eye)
        if len(t_ns) > len(rows):
            dropped.append(f"{eye}: {len(t_ns) - len(rows)} stamps without a picture")
        files.append(found)
        stamps.append(t_ns[rows])
    sizes = size(files[0][0]), size(files[1][0])
    path = place.parent / CAMERAS
    calibration, T_r_p = _cameras(path, pair, sizes, rectified=not place.name.endswith("_extract"))
    truth, assumed = None, []
    if (place / "oxts" / "timestamps.txt").is_file():
        t_imu, T_w_i = _imu(place / "oxts")
        truth = t_imu, T_w_i @ se3.inverse(_T_rect_imu(place.parent)) @ T_r_p
        assumed.append("true poses by GPS and IMU, interpolated")
    return Published(
        (files[0], files[1]),
        (stamps[0], stamps[1]),
        calibration,
        truth,
        tuple(dropped),
        tuple(assumed),
    )


def _rows(files: tuple[Path, ...], n: int, eye: Path) -> list[int]:
    """Rows of the stamps of pictures, whose names are their numbers from 0."""
    try:
        rows = [int(file.stem) for file in files]
    except ValueError:
        raise DatasetError(f"{eye}: picture names should be frame numbers") from None
    if rows[-1] >= n:
        raise DatasetError(f"{eye / 'timestamps.txt'}: {n} rows, too few for {files[-1].name}")
    return rows


def _cameras(
    path: Path,
    pair: tuple[int, int],
    sizes: tuple[tuple[int, int], tuple[int, int]],
    rectified: bool,
) -> tuple[Calibration, Float]:
    """Calibration, and T_r_p (4, 4): primary to the rectified camera 0."""
    rows = keyed(path, "P_rect_00: ... of all cameras")
    if rectified:
        eyes = [projection(path, rows, f"P_rect_0{camera}") for camera in pair]
        return rectified_pair(eyes, sizes), se3.compose(np.eye(3), eyes[0][1])
    cameras, T_c_0 = [], []
    for camera, shape in zip(pair, sizes, strict=True):
        K = entry(path, rows, f"K_0{camera}", 9).reshape(3, 3)
        k = entry(path, rows, f"D_0{camera}", 5).tolist()
        matrix = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
        where = f"{path}: camera {camera}"
        cameras.append(distorted_camera(where, matrix, k, shape, fisheye=False))
        T_c_0.append(_rigid(path, rows, f"R_0{camera}", f"T_0{camera}"))
    R_rect = entry(path, rows, "R_rect_00", 9).reshape(3, 3)
    T_r_0 = se3.compose(R_rect, np.zeros(3))
    T_p_a = T_c_0[0] @ se3.inverse(T_c_0[1])
    return Calibration(tuple(cameras), T_p_a, metric=True), T_r_0 @ se3.inverse(T_c_0[0])


def _rigid(path: Path, rows: dict[str, str], R: str, T: str) -> Float:
    return se3.compose(entry(path, rows, R, 9).reshape(3, 3), entry(path, rows, T, 3))


def _T_rect_imu(place: Path) -> Float:
    """T_r_i (4, 4): GPS and IMU to the rectified camera 0."""
    parts = []
    for name in ("calib_velo_to_cam.txt", "calib_imu_to_velo.txt"):
        rows = keyed(place / name, "R: and T:")
        parts.append(_rigid(place / name, rows, "R", "T"))
    rows = keyed(place / CAMERAS, "R_rect_00: ...")
    R_rect = entry(place / CAMERAS, rows, "R_rect_00", 9).reshape(3, 3)
    return se3.compose(R_rect, np.zeros(3)) @ parts[0] @ parts[1]


def _imu(place: Path) -> tuple[Int, Float]:
    """Stamps (M,) ns and T_w_i (M, 4, 4): x east, y north, z up [m]."""
    t_ns = dated(place / "timestamps.txt")
    files = sorted(folder(place / "data", "0000000000.txt ...").glob("*.txt"))
    if len(files) != len(t_ns) or not files:
        raise DatasetError(f"{place}: {len(files)} files for {len(t_ns)} stamps")
    table = np.array([numbers(file, lines(file, "30 numbers")[0], (30,))[:6] for file in files])
    latitude, longitude, height, roll, pitch, yaw = table.T
    scale = np.cos(np.radians(latitude[0]))
    x = scale * EARTH_M * np.radians(longitude)
    y = scale * EARTH_M * np.log(np.tan(np.radians(90 + latitude) / 2))
    R = Rotation.from_euler("ZYX", np.stack([yaw, pitch, roll], axis=1)).as_matrix()
    return t_ns, se3.compose(R, np.stack([x, y, height], axis=1))


class KittiRaw:
    """Importer of a drive of KITTI raw."""

    name = "KITTI raw"
    reads = "a drive folder of KITTI raw (DATE_drive_NNNN_sync)"

    def recognises(self, sources: tuple[Path, ...]) -> bool:
        """Whether the folder has picture folders of KITTI raw with time stamps."""
        found = any(sources[0].glob("image_0[02]/timestamps.txt"))
        return len(sources) == 1 and found

    def open(
        self,
        sources: tuple[Path, ...],
        options: ImportOptions,
        scratch: Path,
        say: Callable[[str], None],
    ) -> Imported:
        """Read the drive, with the calibration in the folder above it."""
        return imported(read(sources[0].resolve()), self.name)
