"""KITTI odometry, with the true poses published for the sequences 00 to 10."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bench.datasets.drive import Dataset, Drive, first
from calm_edge.interchange.kitti_odometry import read
from calm_edge.interchange.published import DatasetError, folder


def sequences(root: Path) -> list[str]:
    """Names of the sequences with published poses (00 to 10)."""
    there = folder(root / "sequences", "a folder a sequence: 00, 01 ...")
    poses = folder(root / "poses", "the true poses: 00.txt, 01.txt ...")
    names = sorted(p.name for p in there.iterdir() if (poses / f"{p.name}.txt").is_file())
    if not names:
        raise DatasetError(f"{there}: no sequence in it has poses in {poses}")
    return names


def load(root: Path, name: str, frames: int | None = None) -> Drive:
    """Load one sequence; raises DatasetError.

    frames: number of first frames to load, None for all.
    """
    poses = root / "poses" / f"{name}.txt"
    if not poses.is_file():
        raise DatasetError(f"{poses}: missing; only sequences 00 to 10 have published poses")
    found = read(folder(root / "sequences" / name, "image_2, image_3, calib.txt"), poses)
    assert found.truth is not None
    K = np.stack([each.camera.matrix for each in found.calibration.cameras])
    spacing_m = found.calibration.spacing_m or 0.0
    return first(Drive(found.pictures, found.t_ns, K, found.truth[1], spacing_m), frames)


KITTI_ODOMETRY = Dataset("KITTI odometry", sequences, load)
