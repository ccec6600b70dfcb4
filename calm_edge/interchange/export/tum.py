"""Trajectories in the format of the TUM RGB-D benchmark, a file for each camera."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from calm_edge.interchange.export.base import ExportOptions, Written
from calm_edge.interchange.export.drive import ExportedDrive
from calm_edge.interchange.export.frame_poses import PoseSource
from calm_edge.trajectories import write_tum
from device.frame import Eye

KEYFRAMES = "keyframes.tum"


class Tum:
    """`primary.tum` and `assistant.tum`: every frame with a pose; `keyframes.tum`."""

    name = "tum"
    writes = "trajectories for evo and others: rows `t x y z qx qy qz qw`"

    def write(self, drive: ExportedDrive, folder: Path, options: ExportOptions) -> Written:
        """Write the files; frames without a pose are left out."""
        wrote, left_out = [], []
        for eye, poses in drive.frame_poses().items():
            name, known = eye.name.lower(), poses.known
            write_tum(folder / f"{name}.tum", drive.own_ns(poses.t_ns[known]), poses.T_w_c[known])
            wrote.append(f"{name}.tum: {int(known.sum())} poses: {poses.counts()}")
            if not known.all():
                missing = int((poses.source == PoseSource.NONE).sum())
                left_out.append(f"{missing} of {len(known)} frames of the {name}: without a pose")
        k = drive.keyframes
        write_tum(folder / KEYFRAMES, drive.own_ns(k.t_ns), k.T_w_c)
        wrote.append(f"{KEYFRAMES}: {len(k.t_ns)} poses of the primary, which `eval` compares")
        return Written(tuple(wrote), described(drive), (*left_out, "covariances (--to csv)"))


def described(drive: ExportedDrive) -> tuple[str, ...]:
    """Lines on the frame, unit and stamps of exported poses."""
    lines = [
        "poses are camera to world, axes x right, y down, z forward, at the middle row; the world "
        "is the first keyframe",
        f"lengths in {drive.unit}",
        f"stamps {drive.stamps}",
    ]
    late = np.median(drive.lateness[:, 1]) / 1e6
    if Eye.ASSISTANT in drive.eyes:
        lines.append(f"the assistant is exposed {late:+.1f} ms after its stamp")
    return tuple(lines)
