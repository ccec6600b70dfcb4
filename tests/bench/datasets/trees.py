"""Tiny datasets in their published layouts, with a known winding drive as ground truth."""

import json
from pathlib import Path

import cv2
import numpy as np

from calm_edge.geometry import se3
from calm_edge.trajectories import write_kitti
from tests.evaluation.worlds import curve

N = 12
SIZE = (62, 18)
FOCAL, CENTRE = 40.0, (31.0, 9.0)
SPACING_M = 0.54
# Origin of the datasets' worlds: far from zero and rotated.
T_WORLD = se3.exp(np.array([1200.0, -3400.0, 110.0, 0.4, -1.1, 0.3]))


def picture(path: Path, shade: int) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.full((SIZE[1], SIZE[0], 3), shade, np.uint8))


def shade(eye: int, frame: int) -> int:
    """Index of a picture, encoded in its brightness."""
    return 20 * frame % 240 + eye * 5


def projection_row(x_m: float, y_m: float = 0.0) -> str:
    """P of a rectified camera centred at (x, y, 0) m of the reference camera."""
    K = np.array([[FOCAL, 0, CENTRE[0]], [0, FOCAL, CENTRE[1]], [0, 0, 1]])
    P = K @ np.array([[1, 0, 0, -x_m], [0, 1, 0, -y_m], [0, 0, 1, 0]])
    return " ".join(f"{v:.12e}" for v in P.ravel())


def kitti_odometry(root: Path, name: str = "00", cameras: tuple[int, int] = (2, 3)) -> Path:
    """Camera 2 sits at (0.06, 0.01) m of camera 0, camera 3 SPACING_M to its right."""
    place = root / "sequences" / name
    for eye, camera in enumerate(cameras):
        for k in range(N):
            picture(place / f"image_{camera}" / f"{k:06d}.png", shade(eye, k))
    offsets = {0: (0.0, 0.0), 1: (0.5, 0.0), 2: (0.06, 0.01), 3: (0.06 + SPACING_M, 0.01)}
    rows = [f"P{c}: {projection_row(*offset)}" for c, offset in offsets.items()]
    (place / "calib.txt").write_text("\n".join([*rows, "Tr: " + "0 " * 11 + "0"]) + "\n")
    (place / "times.txt").write_text("".join(f"{0.1037 * k:.6e}\n" for k in range(N)))
    (root / "poses").mkdir(exist_ok=True)
    write_kitti(root / "poses" / f"{name}.txt", curve(N))
    return root


# Frames 0 to 2 come before the first pose, 7 and 8 lie in a gap, 13 after the last one.
POSED_360 = (3, 4, 5, 6, 9, 10, 11, 12)
FRAMES_360 = 14
START_360 = "2013-05-28 08:46:02"


def kitti_360(root: Path, number: str = "0003") -> Path:
    """Both eyes start together; the assistant is 4 us late, as a trigger line would make it."""
    drive = f"2013_05_28_drive_{number}_sync"
    for eye in range(2):
        place = root / "data_2d_raw" / drive / f"image_0{eye}"
        for k in range(FRAMES_360):
            picture(place / "data_rect" / f"{k:010d}.png", shade(eye, k))
        stamps = [f"{START_360}.{1_000_000 + 50_000_000 * k + 4000 * eye:09d}" for k in range(14)]
        (place / "timestamps.txt").write_text("\n".join(stamps) + "\n")
    T = T_WORLD @ curve(FRAMES_360)
    rows = [" ".join([str(k), *(f"{v:.10f}" for v in T[k].ravel())]) for k in POSED_360]
    poses = root / "data_poses" / drive
    poses.mkdir(parents=True)
    (poses / "cam0_to_world.txt").write_text("\n".join(rows) + "\n")
    calibration = root / "calibration" / "perspective.txt"
    calibration.parent.mkdir(exist_ok=True)
    text = [f"P_rect_0{eye}: {projection_row(SPACING_M * eye)}" for eye in range(2)]
    calibration.write_text("calib_time: 30-Jul-2013 10:11:59\n" + "\n".join(text) + "\n")
    return root


START_NS = 315_969_904_359_876_000
STEP_NS = 200_000_000
# x forward, y left, z up of the vehicle to x right, y down, z forward of the camera.
R_VEHICLE_CAMERA = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
MOUNTS = {"stereo_front_left": (1.5, 0.15, 1.4), "stereo_front_right": (1.5, -0.149, 1.4)}


def mount(name: str) -> np.ndarray:
    """T_vehicle_camera (4, 4)."""
    return se3.compose(R_VEHICLE_CAMERA, np.array(MOUNTS[name]))


def wxyz(R: np.ndarray) -> list[float]:
    return [float(v) for v in np.roll(se3.quaternions(R[None])[0], 1)]


def argoverse(root: Path, log: str = "0ef28d5c-ae34-370b-99e7-6709e1c4b929") -> Path:
    """A left camera that follows `curve`, 5 Hz; the right one 1 ms late. A wall of LiDAR points
    10 m in front of the vehicle's first pose."""
    place = root / "train1" / log
    T_city_vehicle = T_WORLD @ curve(N) @ se3.inverse(mount("stereo_front_left"))
    cameras = []
    for eye, name in enumerate(MOUNTS):
        for k in range(N):
            ns = START_NS + STEP_NS * k + 1_000_000 * eye
            picture(place / name / f"{name}_{ns}.jpg", shade(eye, k))
        rotation = {"coefficients": wxyz(R_VEHICLE_CAMERA)}
        value = {
            "focal_length_x_px_": FOCAL,
            "focal_length_y_px_": FOCAL,
            "focal_center_x_px_": CENTRE[0],
            "focal_center_y_px_": CENTRE[1],
            "skew_": 0.0,
            "distortion_coefficients_": [0.0, 0.0, 0.0],
            "vehicle_SE3_camera_": {"rotation": rotation, "translation": MOUNTS[name]},
        }
        cameras.append({"key": f"image_raw_{name}", "value": value})
    (place / "vehicle_calibration_info.json").write_text(json.dumps({"camera_data_": cameras}))
    (place / "poses").mkdir()
    for k, T in enumerate(T_city_vehicle):
        pose = {"rotation": wxyz(T[:3, :3]), "translation": T[:3, 3].tolist()}
        name = f"city_SE3_egovehicle_{START_NS + STEP_NS * k}.json"
        (place / "poses" / name).write_text(json.dumps(pose))
    wall = np.stack(np.meshgrid([10.0], np.linspace(-3, 3, 7), [0.0, 2.0]), -1).reshape(-1, 3)
    (place / "lidar").mkdir()
    for k in (0, 3):
        T = se3.inverse(T_city_vehicle[k]) @ T_city_vehicle[0]
        sweep(place / "lidar" / f"PC_{START_NS + STEP_NS * k}.ply", se3.transform(T, wall))
    return root


def sweep(path: Path, points: np.ndarray) -> None:
    """A binary PLY of doubles x y z with an intensity and a laser number."""
    kind = np.dtype([("p", "<f8", 3), ("intensity", "u1"), ("laser_number", "u1")])
    vertices = np.zeros(len(points), kind)
    vertices["p"] = points
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}"]
    header += [f"property double {axis}" for axis in "xyz"]
    header += ["property uchar intensity", "property uchar laser_number", "end_header", ""]
    path.write_bytes("\n".join(header).encode() + vertices.tobytes())
