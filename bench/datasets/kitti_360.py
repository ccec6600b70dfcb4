"""KITTI-360: `data_2d_raw/2013_05_28_drive_XXXX_sync/image_0{0,1}/{data_rect,timestamps.txt}`,
`data_poses/2013_05_28_drive_XXXX_sync/cam0_to_world.txt`, `calibration/perspective.txt`.

Each row of `cam0_to_world.txt` begins with a frame number. Frames are missing there, mostly where
the car hardly moved; their poses are interpolated, with a note. Frames before the first and after
the last pose are left out. Line k (from 0) of `timestamps.txt` belongs to frame k.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bench.datasets.drive import Dataset, Drive, first
from calm_edge.geometry import se3
from calm_edge.interchange.published import (
    DatasetError,
    dated,
    folder,
    keyed,
    lines,
    numbers,
    pngs,
    projection,
)
from calm_edge.types import Float, Int

FRAMES = 2000
DRIVE = "2013_05_28_drive_{}_sync"
# The paper disables loops on this dataset, for all methods.
SETTINGS = ("--set", "loops.enabled=false")


def sequences(root: Path) -> list[str]:
    """Numbers (0000, 0002 ...) of the drives that have both pictures and poses."""
    what = f"a folder a drive: {DRIVE.format('0000')} ..."
    raw, poses = folder(root / "data_2d_raw", what), folder(root / "data_poses", what)
    head, tail = DRIVE.split("{}")
    names = sorted(
        p.name[len(head) : -len(tail)]
        for p in raw.iterdir()
        if p.name.startswith(head) and p.name.endswith(tail) and (poses / p.name).is_dir()
    )
    if not names:
        raise DatasetError(f"{raw}: no drive in it has poses in {poses}")
    return names


def _numbered(files: tuple[Path, ...]) -> dict[int, Path]:
    try:
        return {int(file.stem): file for file in files}
    except ValueError:
        raise DatasetError(f"{files[0].parent}: picture names should be frame numbers") from None


def _poses(path: Path) -> tuple[Int, Float]:
    """Read the frame numbers (P,), sorted, and poses T_w_c (P, 4, 4)."""
    rows = [numbers(path, row, (13, 17)) for row in lines(path, "a frame's number and its pose")]
    if len(rows) < 2:
        raise DatasetError(f"{path}: {len(rows)} poses; at least two are needed")
    rows.sort(key=lambda row: row[0])
    T = np.tile(np.eye(4), (len(rows), 1, 1))
    T[:, :3] = np.array([row[1:13] for row in rows]).reshape(-1, 3, 4)
    return np.array([int(row[0]) for row in rows], np.int64), T


def load(root: Path, name: str, frames: int | None = None) -> Drive:
    """Load the drive named `0000`, `00`, `0` or by its folder; raises DatasetError.

    frames: number of first frames to load, None for all.
    """
    drive = name if name.startswith("2013") else DRIVE.format(name.zfill(4))
    raw = folder(root / "data_2d_raw" / drive, "image_00 and image_01")
    eyes = [raw / f"image_0{eye}" for eye in range(2)]
    pictures = [_numbered(pngs(eye / "data_rect", "pictures 0000000000.png ...")) for eye in eyes]
    stamps = [dated(eye / "timestamps.txt") for eye in eyes]
    numbered, T_w_c = _poses(root / "data_poses" / drive / "cam0_to_world.txt")
    both = np.array(sorted(set(pictures[0]) & set(pictures[1])), np.int64)
    chosen = both[(both >= numbered[0]) & (both <= numbered[-1])]
    if len(chosen) == 0:
        raise DatasetError(
            f"{raw}: no frame with both pictures lies between the first and the last pose"
        )
    for eye, t in zip(eyes, stamps, strict=True):
        if chosen[-1] >= len(t):
            raise DatasetError(
                f"{eye / 'timestamps.txt'}: {len(t)} rows, too few for frame {chosen[-1]}"
            )
    t_ns = (stamps[0][chosen], stamps[1][chosen])
    known = numbered < len(stamps[0])
    t_known, start = stamps[0][numbered[known]], int(stamps[0][0])
    T = se3.interpolate_at((t_known - start) / 1e9, T_w_c[known], (t_ns[0] - start) / 1e9)
    calib = root / "calibration" / "perspective.txt"
    rows = keyed(calib, "P_rect_00: and P_rect_01:, twelve numbers each")
    cameras = [projection(calib, rows, f"P_rect_0{eye}") for eye in range(2)]
    whole = Drive(
        (tuple(pictures[0][i] for i in chosen), tuple(pictures[1][i] for i in chosen)),
        t_ns,
        np.stack([K for K, _ in cameras]),
        T,
        float(np.linalg.norm(cameras[1][1] - cameras[0][1])),
        notes=_notes(both, chosen[:frames], numbered),
    )
    return first(whole, frames)


def _notes(both: Int, chosen: Int, numbered: Int) -> tuple[str, ...]:
    notes = []
    before = int((both < numbered[0]).sum())
    if before:
        notes.append(f"{before} frames before the first pose are left out")
    missing = int((~np.isin(chosen, numbered)).sum())
    if missing:
        gap = int(np.diff(numbered[numbered <= chosen[-1] + 1]).max(initial=1))
        notes.append(
            f"the truth of {missing} of {len(chosen)} frames is interpolated; "
            f"poses are at most {gap} frames apart"
        )
    return tuple(notes)


KITTI_360 = Dataset("KITTI-360", sequences, load, FRAMES, SETTINGS)
