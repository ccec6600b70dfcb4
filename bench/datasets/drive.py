"""A drive of a dataset: pictures, stamps and ground truth, to be written as a sequence folder."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calm_edge.geometry import se3
from calm_edge.interchange.published import DatasetError
from calm_edge.recording.picture_file import PictureFiles
from calm_edge.trajectories import write_kitti
from calm_edge.types import Float, Int


@dataclass(frozen=True, slots=True)
class Drive:
    """Two picture streams and the ground truth of the primary camera.

    pictures, t_ns: (N,) files and stamps, one tuple entry per eye. K: (2, 3, 3) px. T_w_c: (N, 4,
    4) of the primary's pictures, metres. spacing_m: camera spacing by the published calibration.
    cloud: true points (M, 3) in the world of T_w_c, or None. notes: what was assumed or
    interpolated.
    """

    pictures: tuple[tuple[Path, ...], tuple[Path, ...]]
    t_ns: tuple[Int, Int]
    K: Float
    T_w_c: Float
    spacing_m: float
    cloud: Float | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Dataset:
    """Loader of one dataset.

    sequences: (root) -> names of sequences with ground truth. load: (root, name, frames) -> drive,
    of the first `frames` pairs if not None. Both raise DatasetError. frames: number of pairs used
    in the paper. settings: options of `record` for the paper's configuration. cloud: whether the
    dataset has a true point cloud.
    """

    title: str
    sequences: Callable[[Path], list[str]]
    load: Callable[[Path, str, int | None], Drive]
    frames: int | None = None
    settings: tuple[str, ...] = ()
    cloud: bool = False


def first(drive: Drive, frames: int | None) -> Drive:
    """Keep the first `frames` frames of both streams; all if None."""
    if frames is None:
        return drive
    return replace(
        drive,
        pictures=(drive.pictures[0][:frames], drive.pictures[1][:frames]),
        t_ns=(drive.t_ns[0][:frames], drive.t_ns[1][:frames]),
        T_w_c=drive.T_w_c[:frames],
    )


def odd_even(drive: Drive) -> Drive:
    """Make the drive asynchronous as in the paper.

    The primary keeps the odd frames, the assistant the even ones, counted from 0.
    """
    return replace(
        drive,
        pictures=(drive.pictures[0][1::2], drive.pictures[1][::2]),
        t_ns=(drive.t_ns[0][1::2], drive.t_ns[1][::2]),
        T_w_c=drive.T_w_c[1::2],
    )


def write(drive: Drive, out: Path) -> Path:
    """Write a drive as the sequence folder `out` with links to the pictures; return `out`.

    An earlier folder is replaced. The world is the first primary camera. Raises DatasetError for an
    empty stream.
    """
    if not (drive.pictures[0] and drive.pictures[1]):
        raise DatasetError(f"{out.name}: one camera has no pictures")
    shutil.rmtree(out, ignore_errors=True)
    start = min(int(t[0]) for t in drive.t_ns)
    calibration = []
    for eye in range(2):
        (out / f"cam{eye}").mkdir(parents=True)
        for k, picture in enumerate(drive.pictures[eye]):
            link = out / f"cam{eye}" / f"{k:06d}{picture.suffix.lower()}"
            link.symlink_to(picture.resolve())
        stamps = drive.t_ns[eye] - start
        rows = (f"{t // 10**9}.{t % 10**9:09d}\n" for t in stamps.tolist())
        (out / f"times{eye}.txt").write_text("".join(rows))
        K, size = drive.K[eye], PictureFiles(drive.pictures[eye][:1]).size
        values = (K[0, 0], K[1, 1], K[0, 2], K[1, 2], *size)
        calibration.append(" ".join(f"{value:.9g}" for value in values))
    (out / "calib.txt").write_text("\n".join(calibration) + "\n")
    T_c_w = se3.inverse(drive.T_w_c[0])
    write_kitti(out / "poses0.txt", T_c_w @ drive.T_w_c)
    if drive.cloud is not None:
        np.save(out / "cloud.npy", se3.transform(T_c_w, drive.cloud).astype(np.float32))
    return out
