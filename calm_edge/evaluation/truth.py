"""Ground truth of a sequence folder: poses, intrinsics and point cloud; for evaluation only."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calm_edge.evaluation import EvaluationError
from calm_edge.geometry.camera import Camera
from calm_edge.geometry.camera_row import EXPECTED, parsed_camera
from calm_edge.recording.picture_folder import DEFAULT_RATE_HZ
from calm_edge.recording.sequence_folder import ORIGIN_NS, read_times
from calm_edge.trajectories import read_kitti
from calm_edge.types import Float, Float32, Int


@dataclass(frozen=True, slots=True)
class Truth:
    """Ground truth of a sequence folder, in metres.

    t_ns: (N,) stamps as `recording.sequence_folder` gives them. T_w_c: (N, 4, 4) primary camera
    -> world, N = 0 without poses. cameras: one per eye, or None. cloud: (M, 3) or None.
    """

    t_ns: Int
    T_w_c: Float
    cameras: tuple[Camera, Camera] | None = None
    cloud: Float32 | None = None


def _calibration(path: Path) -> tuple[Camera, Camera]:
    try:
        lines = [line for line in path.read_text("utf-8-sig").splitlines() if line]
        cameras = [parsed_camera(line) for line in lines]
    except (OSError, ValueError) as error:
        raise EvaluationError(f"{path}: not rows of {EXPECTED} ({error})") from None
    if len(cameras) != 2:
        raise EvaluationError(f"{path}: expected two rows of {EXPECTED}, got {len(cameras)}")
    return cameras[0], cameras[1]


def _cloud(path: Path) -> NDArray[np.float32]:
    try:
        points = np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise EvaluationError(f"{path}: not a NumPy array ({error})") from None
    if points.ndim != 2 or points.shape[1] != 3 or len(points) == 0:
        raise EvaluationError(f"{path}: expected an (N, 3) array of points, got {points.shape}")
    return np.asarray(points, np.float32)


def read_truth(folder: Path) -> Truth:
    """Read poses0.txt, calib.txt and cloud.npy of a sequence folder, each if present.

    Raises EvaluationError if the folder or all three files are missing, or if one is malformed.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise EvaluationError(f"{folder}: no such folder; give --truth a sequence folder")
    poses, times = folder / "poses0.txt", folder / "times0.txt"
    calibration, cloud = folder / "calib.txt", folder / "cloud.npy"
    if not (poses.is_file() or calibration.is_file() or cloud.is_file()):
        raise EvaluationError(
            f"{folder}: holds none of poses0.txt, calib.txt, cloud.npy; give a sequence folder"
        )
    T_w_c = read_kitti(poses) if poses.is_file() else np.zeros((0, 4, 4))
    n = len(T_w_c)
    if n and times.is_file():
        t_ns = read_times(times)
        if len(t_ns) != n:
            raise EvaluationError(
                f"{poses}: {n} poses for {len(t_ns)} times in {times.name}; write one line each"
            )
    else:
        t_ns = np.arange(n, dtype=np.int64) * round(1e9 / DEFAULT_RATE_HZ) + ORIGIN_NS
    return Truth(
        t_ns,
        T_w_c,
        _calibration(calibration) if calibration.is_file() else None,
        _cloud(cloud) if cloud.is_file() else None,
    )
