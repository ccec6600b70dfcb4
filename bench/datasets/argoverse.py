"""Argoverse 1 tracking: `LOG/{stereo_front_left,stereo_front_right,poses,lidar}` and
`LOG/vehicle_calibration_info.json`, the logs in ROOT, ROOT/train1 or ROOT/*/train1.

Stamps are the nanoseconds in the file names, poses `city_SE3_egovehicle_NS.json` with a
scalar-first quaternion. Pictures are assumed undistorted; the LiDAR sweeps, each in the vehicle's
frame at its stamp, form the true cloud.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bench.datasets.drive import Dataset, Drive, first
from bench.datasets.point_file import read_points
from calm_edge.geometry import se3
from calm_edge.interchange.published import DatasetError, folder
from calm_edge.types import Float, Int

EYES = ("stereo_front_left", "stereo_front_right")
CALIBRATION = "vehicle_calibration_info.json"
LOGS = 10

# Range of the points kept: farther ones lie in other streets, nearer ones on the vehicle itself.
RANGE_M = (2.0, 60.0)
VOXEL_M = 0.15


def _logs(root: Path) -> dict[str, Path]:
    folder(root, "the logs, or train1, train2 ... with them")
    found = {
        file.parent.name: file.parent
        for pattern in ("*", "*/*", "*/*/*")
        for file in root.glob(f"{pattern}/{CALIBRATION}")
    }
    if not found:
        raise DatasetError(f"{root}: {CALIBRATION} is in no folder LOG, train*/LOG or */train*/LOG")
    return dict(sorted(found.items()))


def sequences(root: Path) -> list[str]:
    """Names of the first LOGS logs, by name, that have stereo pictures; the paper uses as many."""
    logs = _logs(root)
    return [name for name, log in logs.items() if (log / EYES[0]).is_dir()][:LOGS]


def _log(root: Path, name: str) -> Path:
    logs = _logs(root)
    matching = [log for known, log in logs.items() if known.startswith(name)]
    if len(matching) != 1:
        raise DatasetError(
            f"{root}: {len(matching)} logs begin with {name!r}; give the name of one"
        )
    return matching[0]


def _json(path: Path, what: str) -> Any:
    try:
        return json.loads(path.read_text())
    except (OSError, ValueError):
        raise DatasetError(f"{path}: cannot be read; it should hold {what}") from None


def _stamped(place: Path, stem: str, suffix: str) -> dict[int, Path]:
    """Files `place`/`stem`NS`suffix` as {NS: file}, sorted by NS [ns].

    Raises DatasetError if there are none.
    """
    what = f"{stem}NANOSECONDS{suffix}"
    files = folder(place, what).glob(f"{stem}*{suffix}")
    try:
        found = {int(file.stem[len(stem) :]): file for file in files}
    except ValueError:
        raise DatasetError(f"{place}: a file name does not match {what}") from None
    if not found:
        raise DatasetError(f"{place}: empty; it should hold {what}")
    return dict(sorted(found.items()))


def _pose(path: Path, rotation: Any, translation: Any) -> Float:
    """Pose (4, 4) from a scalar-first quaternion and a translation [m]; raises DatasetError."""
    try:
        q, t = np.array(rotation, np.float64), np.array(translation, np.float64)
    except (TypeError, ValueError):
        q, t = np.zeros(0), np.zeros(0)
    if q.shape != (4,) or t.shape != (3,) or np.linalg.norm(q) < 1e-6:
        raise DatasetError(f"{path}: a pose needs a quaternion of 4 and a translation of 3 numbers")
    return se3.compose(se3.rotations(np.roll(q / np.linalg.norm(q), -1)), t)


def _camera(path: Path, calibration: Any, name: str) -> tuple[Float, Float]:
    """K (3, 3) px and T_vehicle_camera (4, 4) of the camera `name`; raises DatasetError."""
    try:
        (value,) = [
            c["value"] for c in calibration["camera_data_"] if c["key"] == f"image_raw_{name}"
        ]
        fx, fy = (float(value[f"focal_length_{axis}_px_"]) for axis in "xy")
        cx, cy = (float(value[f"focal_center_{axis}_px_"]) for axis in "xy")
        K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
        mounted = value["vehicle_SE3_camera_"]
        rotation, translation = mounted["rotation"]["coefficients"], mounted["translation"]
    except (KeyError, TypeError, ValueError):
        raise DatasetError(f"{path}: has no calibration of image_raw_{name}") from None
    return K, _pose(path, rotation, translation)


def _trajectory(place: Path) -> tuple[Int, Float]:
    """Read the stamps (P,) ns and T_city_vehicle (P, 4, 4) of a log; raises DatasetError."""
    files = _stamped(place, "city_SE3_egovehicle_", ".json")
    if len(files) < 2:
        raise DatasetError(f"{place}: {len(files)} pose file; at least 2 are needed")
    poses = []
    for path in files.values():
        pose = _json(path, "a rotation and a translation")
        pose = pose if isinstance(pose, dict) else {}
        poses.append(_pose(path, pose.get("rotation"), pose.get("translation")))
    return np.array(list(files), np.int64), np.stack(poses)


def _cloud(place: Path, t_pose: Int, T_w_v: Float, last_ns: int) -> Float | None:
    """Points (M, 3) in the city frame from the LiDAR sweeps until `last_ns`, one per voxel.

    t_pose: (P,) ns. T_w_v: (P, 4, 4) poses of the vehicle. None without sweeps.
    """
    if not place.is_dir():
        return None
    origin = T_w_v[0, :3, 3]
    kept: dict[tuple[int, int, int], Float] = {}
    for t, path in _stamped(place, "PC_", ".ply").items():
        if not t_pose[0] <= t <= min(int(t_pose[-1]), last_ns):
            continue
        p = read_points(path)
        distance = np.linalg.norm(p, axis=1)
        p = p[(distance > RANGE_M[0]) & (distance < RANGE_M[1])]
        T = se3.interpolate_at((t_pose - t_pose[0]) / 1e9, T_w_v, np.array([(t - t_pose[0]) / 1e9]))
        p = se3.transform(T[0], p)
        cells = np.floor((p - origin) / VOXEL_M).astype(np.int64)
        unique, index = np.unique(cells, axis=0, return_index=True)
        for cell, i in zip(map(tuple, unique.tolist()), index, strict=True):
            kept.setdefault(cell, p[i])
    return np.array(list(kept.values())) if kept else None


def load(root: Path, name: str, frames: int | None = None) -> Drive:
    """Load the log with this name, or with this unique beginning of its name.

    frames: number of first frames to load, None for all. Raises DatasetError.
    """
    log = _log(root, name)
    calibration = _json(log / CALIBRATION, "camera_data_")
    cameras = [_camera(log / CALIBRATION, calibration, eye) for eye in EYES]
    pictures = [_stamped(log / eye, f"{eye}_", ".jpg") for eye in EYES]
    t_pose, T_w_v = _trajectory(log / "poses")
    inside = [[t for t in p if t_pose[0] <= t <= t_pose[-1]] for p in pictures]
    if not all(inside):
        raise DatasetError(
            f"{log / 'poses'}: one camera has no picture between the first and the last pose"
        )
    t_ns = (np.array(inside[0], np.int64), np.array(inside[1], np.int64))
    seconds = (t_pose - t_pose[0]) / 1e9
    T = se3.interpolate_at(seconds, T_w_v, (t_ns[0] - t_pose[0]) / 1e9) @ cameras[0][1]
    outside = sum(map(len, pictures)) - sum(map(len, inside))
    whole = Drive(
        (
            tuple(pictures[0][t] for t in inside[0]),
            tuple(pictures[1][t] for t in inside[1]),
        ),
        t_ns,
        np.stack([K for K, _ in cameras]),
        T,
        float(np.linalg.norm(cameras[1][1][:3, 3] - cameras[0][1][:3, 3])),
        notes=(f"{outside} pictures before the first or after the last pose are left out",)
        if outside
        else (),
    )
    drive = first(whole, frames)
    cloud = _cloud(log / "lidar", t_pose, T_w_v, int(drive.t_ns[0][-1]))
    return replace(drive, cloud=cloud)


ARGOVERSE = Dataset("Argoverse 1", sequences, load, cloud=True)
