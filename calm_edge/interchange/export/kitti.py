"""Trajectories in the format of the KITTI odometry benchmark: one row a frame, without stamps."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from calm_edge.interchange import InterchangeError
from calm_edge.interchange.export.base import ExportOptions, Written
from calm_edge.interchange.export.drive import ExportedDrive
from calm_edge.interchange.export.frame_poses import FramePoses
from calm_edge.interchange.export.tum import described
from calm_edge.trajectories import seconds, write_kitti
from calm_edge.types import Float, Int


class Kitti:
    """`primary.txt`, `assistant.txt`; frames that were filled in are listed in a sidecar."""

    name = "kitti"
    writes = "trajectories: rows of [R|t], one for each frame"

    def write(self, drive: ExportedDrive, folder: Path, options: ExportOptions) -> Written:
        """Write the files; raises InterchangeError if no frame of an eye has a pose."""
        wrote, left_out = [], ["stamps: the format has none; they are in the _times.txt beside"]
        for eye, poses in drive.frame_poses().items():
            name = eye.name.lower()
            if not poses.known.any():
                raise InterchangeError(f"{drive.path}: no frame of the {name} has a pose")
            T, filled = filled_in(poses)
            write_kitti(folder / f"{name}.txt", T)
            own = drive.own_ns(poses.t_ns).tolist()
            (folder / f"{name}_times.txt").write_text("".join(f"{seconds(t)}\n" for t in own))
            rows = "".join(f"{i} {seconds(own[i])}\n" for i in filled.tolist())
            head = "# rows, from 0, of frames without a pose, with their stamps: the nearest pose\n"
            (folder / f"{name}_filled_in.txt").write_text(head + rows)
            wrote.append(f"{name}.txt: {len(T)} rows, one for each frame: {poses.counts()}")
            if len(filled):
                left_out.append(
                    f"{len(filled)} frames of the {name} have no pose: their rows repeat the "
                    f"nearest one, listed in {name}_filled_in.txt"
                )
        return Written(tuple(wrote), described(drive), tuple(left_out))


def filled_in(poses: FramePoses) -> tuple[Float, Int]:
    """Poses (F, 4, 4) with missing ones replaced by the nearest in time; indices of these."""
    known = np.flatnonzero(poses.known)
    t, missing = poses.t_ns[known], np.flatnonzero(~poses.known)
    right = np.clip(np.searchsorted(t, poses.t_ns[missing]), 0, len(t) - 1)
    left = np.maximum(right - 1, 0)
    nearer_left = np.abs(poses.t_ns[missing] - t[left]) <= np.abs(t[right] - poses.t_ns[missing])
    T = poses.T_w_c.copy()
    T[missing] = T[known[np.where(nearer_left, left, right)]]
    return T, missing
