"""KITTI odometry: `sequences/XX/{image_2,image_3,calib.txt,times.txt}` and `poses/XX.txt`.

Uses the colour cameras if their pictures exist, else the grey ones (image_0, image_1). Both
pictures of a pair have the stamp in `times.txt`. `poses` are those of the rectified camera 0.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from calm_edge.geometry import se3
from calm_edge.geometry.camera import Perspective
from calm_edge.interchange.base import Imported, ImportOptions
from calm_edge.interchange.calibration.calibration import CalibratedCamera, Calibration
from calm_edge.interchange.published import (
    DatasetError,
    Published,
    folder,
    imported,
    keyed,
    lines,
    numbers,
    pngs,
    projection,
    size,
)
from calm_edge.trajectories import read_kitti

COLOUR, GREY = (2, 3), (0, 1)


def read(place: Path, poses: Path | None) -> Published:
    """Read the folder of a sequence and the file of its true poses; raises DatasetError."""
    folder(place, "image_2, image_3, calib.txt and times.txt")
    cameras = COLOUR if (place / f"image_{COLOUR[0]}").is_dir() else GREY
    pictures = tuple(pngs(place / f"image_{c}", "pictures 000000.png ...") for c in cameras)
    calib, times = place / "calib.txt", place / "times.txt"
    rows = keyed(calib, "P0: ... P3:, twelve numbers each")
    eyes = [projection(calib, rows, f"P{c}") for c in cameras]
    seconds = np.concatenate([numbers(times, row, (1,)) for row in lines(times, "a time a row")])
    T_w_0 = None if poses is None else read_kitti(poses)
    counts = [len(pictures[0]), len(pictures[1]), len(seconds)]
    counts += [] if T_w_0 is None else [len(T_w_0)]
    if len(set(counts)) != 1:
        with_poses = "" if T_w_0 is None else f", {len(T_w_0)} poses"
        raise DatasetError(
            f"{place}: {len(pictures[0])} and {len(pictures[1])} pictures, {len(seconds)} times"
            f"{with_poses}; the numbers should be equal"
        )
    t_ns = np.round(seconds * 1e9).astype(np.int64)
    T_0_c = se3.compose(np.eye(3), eyes[0][1])
    return Published(
        (pictures[0], pictures[1]),
        (t_ns, t_ns),
        rectified_pair(eyes, (size(pictures[0][0]), size(pictures[1][0]))),
        None if T_w_0 is None else (t_ns, T_w_0 @ T_0_c),
    )


def rectified_pair(
    eyes: list[tuple[np.ndarray, np.ndarray]], sizes: tuple[tuple[int, int], tuple[int, int]]
) -> Calibration:
    """Calibration of two rectified cameras, given K (3, 3) px and centre (3,) m of each."""
    cameras = tuple(
        CalibratedCamera(Perspective(K[0, 0], K[1, 1], K[0, 2], K[1, 2], *shape), "rectified")
        for (K, _), shape in zip(eyes, sizes, strict=True)
    )
    T_p_a = se3.compose(np.eye(3), eyes[1][1] - eyes[0][1])
    return Calibration(cameras, T_p_a, metric=True)


class KittiOdometry:
    """Importer of a sequence of KITTI odometry."""

    name = "KITTI odometry"
    reads = "a sequence folder of KITTI odometry (sequences/XX)"

    def recognises(self, sources: tuple[Path, ...]) -> bool:
        """Whether the folder has calib.txt, times.txt and numbered picture folders."""
        place = sources[0]
        there = all((place / name).is_file() for name in ("calib.txt", "times.txt"))
        return len(sources) == 1 and there and any(place.glob("image_[02]"))

    def open(
        self,
        sources: tuple[Path, ...],
        options: ImportOptions,
        scratch: Path,
        say: Callable[[str], None],
    ) -> Imported:
        """Read the sequence, with poses/XX.txt beside `sequences` if it is there."""
        place = sources[0].resolve()
        poses = place.parents[1] / "poses" / f"{place.name}.txt"
        return imported(read(place, poses if poses.is_file() else None), self.name)
