"""Small data sets in their published layouts, of a drive along x east with a known heading."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from calm_edge.geometry import se3
from calm_edge.trajectories import write_kitti
from calm_edge.types import Float
from tests.interchange.moving import SIZE, pictures

FOCAL, CENTRE = 120.0, (80.5, 47.5)
SPACING_M = 0.54
START_NS = 1_317_042_272_123_456_789
SPEED = 8.0
# axes of a camera (x right, y down, z forward) in those of a vehicle (x forward, y left, z up)
R_v_c = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])


def car(t: Float) -> Float:
    """T_w_v (N, 4, 4) of the vehicle: east along a gentle curve, z up."""
    heading = 0.05 * t
    R = Rotation.from_euler("z", heading[:, None]).as_matrix()
    x, y = SPEED * np.sin(heading) / 0.05, SPEED * (1 - np.cos(heading)) / 0.05
    return se3.compose(R, np.stack([x, y, np.zeros_like(x)], axis=1))


def primary(t: Float) -> Float:
    """Poses of the primary camera, which is at the vehicle's origin, from its first."""
    T = car(t) @ se3.compose(R_v_c, np.zeros(3))
    return se3.inverse(T[0]) @ T


def shoot(folder: Path, t: Float, eye: int, names: list[str]) -> None:
    folder.mkdir(parents=True)
    for name, picture in zip(names, pictures(t + 0.1 * eye), strict=True):
        cv2.imwrite(str(folder / name), picture)


def _projection(x_m: float) -> str:
    P = [FOCAL, 0, CENTRE[0], -FOCAL * x_m, 0, FOCAL, CENTRE[1], 0, 0, 0, 1, 0]
    return " ".join(f"{v:.9e}" for v in P)


def kitti_odometry(root: Path, t: Float) -> Path:
    """The sequence folder; its true poses are beside `sequences`."""
    place = root / "sequences" / "03"
    for eye in range(2):
        shoot(place / f"image_{2 + eye}", t, eye, [f"{k:06d}.png" for k in range(len(t))])
    rows = [f"P{c}: {_projection(x)}" for c, x in enumerate((0.0, SPACING_M, 0.0, SPACING_M))]
    (place / "calib.txt").write_text("\n".join(rows) + "\n")
    (place / "times.txt").write_text("".join(f"{v:.6e}\n" for v in t))
    (root / "poses").mkdir()
    write_kitti(root / "poses" / "03.txt", primary(t))
    return place


def _date(t_ns: int) -> str:
    at = np.datetime64(t_ns, "ns")
    return str(at).replace("T", " ")


def kitti_raw(root: Path, t: Float, kind: str = "sync") -> Path:
    """The drive folder; the IMU is 0.8 m behind the camera and 0.9 m below."""
    day = root / "2011_09_26"
    place = day / f"2011_09_26_drive_0001_{kind}"
    stamps = [_date(START_NS + round(1e9 * v)) for v in t]
    for eye in range(2):
        camera = place / f"image_0{2 + eye}"
        shoot(camera / "data", t, eye, [f"{k:010d}.png" for k in range(len(t))])
        (camera / "timestamps.txt").write_text("\n".join(stamps) + "\n")
    rows = ["R_rect_00: 1 0 0 0 1 0 0 0 1"]
    for c, x in ((0, 0.0), (2, 0.0), (3, SPACING_M)):
        K = f"{FOCAL} 0 {CENTRE[0]} 0 {FOCAL} {CENTRE[1]} 0 0 1"
        rows += [f"K_0{c}: {K}", f"D_0{c}: -0.1 0.01 0 0 0", f"R_0{c}: 1 0 0 0 1 0 0 0 1"]
        rows += [f"T_0{c}: {-x} 0 0", f"P_rect_0{c}: {_projection(x)}"]
    (day / "calib_cam_to_cam.txt").write_text("calib_time: 09-Jan-2012\n" + "\n".join(rows) + "\n")
    R_c_v = " ".join(f"{v:g}" for v in R_v_c.T.ravel())
    (day / "calib_velo_to_cam.txt").write_text(f"R: {R_c_v}\nT: 0 0 0\n")
    (day / "calib_imu_to_velo.txt").write_text("R: 1 0 0 0 1 0 0 0 1\nT: -0.8 0 -0.9\n")
    T_w_i = car(t) @ se3.compose(np.eye(3), np.array([-0.8, 0, -0.9]))
    data = place / "oxts" / "data"
    data.mkdir(parents=True)
    (place / "oxts" / "timestamps.txt").write_text("\n".join(stamps) + "\n")
    latitude, longitude, earth = 49.0, 8.4, 6378137.0
    for k, T in enumerate(T_w_i):
        # the Mercator projection is true to scale at its latitude
        north, east = T[1, 3] / earth, T[0, 3] / earth / np.cos(np.radians(latitude))
        place_deg = latitude + np.degrees(north), longitude + np.degrees(east)
        row = [*place_deg, T[2, 3], 0, 0, 0.05 * t[k], *[0] * 24]
        (data / f"{k:010d}.txt").write_text(" ".join(f"{v:.14g}" for v in row) + "\n")
    return place


def euroc(root: Path, t: Float) -> Path:
    """The folder with mav0; the body is 0.1 m right of the primary, its axes are a vehicle's."""
    mav = root / "mav0"
    for eye in range(2):
        names = [f"{START_NS + round(1e9 * v)}.png" for v in t]
        shoot(mav / f"cam{eye}" / "data", t, eye, names)
        rows = "".join(f"{name[:-4]},{name}\n" for name in names)
        (mav / f"cam{eye}" / "data.csv").write_text("#timestamp [ns],filename\n" + rows)
        T = se3.compose(R_v_c, np.array([0.0, 0.1 - SPACING_M * eye, 0.0]))
        data = ", ".join(f"{v:g}" for v in T.ravel())
        (mav / f"cam{eye}" / "sensor.yaml").write_text(
            f"sensor_type: camera\nT_BS:\n  cols: 4\n  rows: 4\n  data: [{data}]\n"
            f"resolution: [{SIZE[0]}, {SIZE[1]}]\ncamera_model: pinhole\n"
            f"intrinsics: [{FOCAL}, {FOCAL}, {CENTRE[0]}, {CENTRE[1]}]\n"
            "distortion_model: radial-tangential\n"
            "distortion_coefficients: [-0.1, 0.01, 0.0, 0.0]\n"
        )
    # the true poses are given at other times than the pictures
    at = np.arange(t[0] - 0.013, t[-1] + 0.02, 0.005)
    T_w_b = car(at) @ se3.compose(np.eye(3), np.array([0.0, -0.1, 0.0]))
    place = mav / "state_groundtruth_estimate0"
    place.mkdir()
    rows = []
    for v, T in zip(at, T_w_b, strict=True):
        q = Rotation.from_matrix(T[:3, :3]).as_quat()
        values = [*T[:3, 3], q[3], *q[:3], *[0.0] * 9]
        rows.append(",".join([str(START_NS + round(1e9 * v)), *(f"{x:.9f}" for x in values)]))
    (place / "data.csv").write_text("#timestamp, p_RS_R_x [m], ...\n" + "\n".join(rows) + "\n")
    return root
