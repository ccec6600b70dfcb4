"""KITTI odometry: `sequences/XX/{image_2,image_3,calib.txt,times.txt}` and `poses/XX.txt`.

Uses the colour cameras if their pictures exist, else the grey ones (image_0, image_1). Both
pictures of a pair have the stamp in `times.txt`. `poses` are those of the rectified camera 0.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bench.datasets.drive import (
    Dataset,
    DatasetError,
    Drive,
    first,
    folder,
    keyed,
    lines,
    numbers,
    pngs,
    projection,
)
from calm_edge.geometry import se3
from calm_edge.trajectories import read_kitti

COLOUR, GREY = (2, 3), (0, 1)


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
    place = folder(root / "sequences" / name, "image_2, image_3, calib.txt and times.txt")
    cameras = COLOUR if (place / f"image_{COLOUR[0]}").is_dir() else GREY
    pictures = tuple(pngs(place / f"image_{c}", "pictures 000000.png ...") for c in cameras)
    calib, times = place / "calib.txt", place / "times.txt"
    rows = keyed(calib, "P0: ... P3:, twelve numbers each")
    eyes = [projection(calib, rows, f"P{c}") for c in cameras]
    seconds = np.concatenate([numbers(times, row, (1,)) for row in lines(times, "a time a row")])
    poses = root / "poses" / f"{name}.txt"
    if not poses.is_file():
        raise DatasetError(f"{poses}: missing; only sequences 00 to 10 have published poses")
    T_w_0 = read_kitti(poses)
    counts = {len(pictures[0]), len(pictures[1]), len(seconds), len(T_w_0)}
    if len(counts) != 1:
        raise DatasetError(
            f"{place}: {len(pictures[0])} and {len(pictures[1])} pictures, {len(seconds)} times, "
            f"{len(T_w_0)} poses; the numbers should be equal"
        )
    t_ns = np.round(seconds * 1e9).astype(np.int64)
    drive = Drive(
        (pictures[0], pictures[1]),
        (t_ns, t_ns),
        np.stack([K for K, _ in eyes]),
        T_w_0 @ se3.compose(np.eye(3), eyes[0][1]),
        float(np.linalg.norm(eyes[1][1] - eyes[0][1])),
    )
    return first(drive, frames)


KITTI_ODOMETRY = Dataset("KITTI odometry", sequences, load)
