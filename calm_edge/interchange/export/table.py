"""Trajectories as CSV tables, with the covariance of each pose."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from calm_edge.geometry import se3
from calm_edge.interchange.export.base import ExportOptions, Written
from calm_edge.interchange.export.drive import ExportedDrive
from calm_edge.interchange.export.tum import described
from calm_edge.trajectories import seconds
from calm_edge.types import Float
from device.frame import Eye

AXES = ("x", "y", "z", "rx", "ry", "rz")
UPPER = np.triu_indices(6)
COVARIANCE = tuple(f"cov_{AXES[i]}_{AXES[j]}" for i, j in zip(*UPPER, strict=True))
COLUMNS = ("t_s", "source", "x", "y", "z", "qx", "qy", "qz", "qw", *COVARIANCE)


class Table:
    """`primary.csv` and `assistant.csv`: a row for each frame, empty where there is no pose."""

    name = "csv"
    writes = "trajectories with covariances: a row for each frame, and where its pose is from"

    def write(self, drive: ExportedDrive, folder: Path, options: ExportOptions) -> Written:
        """Write the tables. Units: seconds, world units, rad."""
        covariances = {
            sample.t_ns: sample.with_drift()[0]
            for sample in drive.recording.poses()
            if sample.status.usable
        }
        wrote, left_out = [], []
        for eye, poses in drive.frame_poses().items():
            name, known = eye.name.lower(), poses.known
            q = np.zeros((len(known), 4))
            q[known] = se3.quaternions(poses.T_w_c[known, :3, :3])
            with (folder / f"{name}.csv").open("w", newline="") as file:
                rows = csv.writer(file)
                rows.writerow(COLUMNS)
                for i, t in enumerate(poses.t_ns.tolist()):
                    place = [*poses.T_w_c[i, :3, 3].tolist(), *q[i].tolist()] if known[i] else []
                    C = covariances.get(t) if known[i] and eye is Eye.PRIMARY else None
                    row = [seconds(t + drive.stamp_ns), str(poses.source[i]), *_text(place, 7)]
                    rows.writerow([*row, *_text(upper(C), len(COVARIANCE))])
            wrote.append(f"{name}.csv: {len(known)} rows: {poses.counts()}")
            if eye is Eye.ASSISTANT:
                left_out.append("covariances of the assistant's poses: not estimated")
        assumed = (
            *described(drive),
            "the covariance is that of the live pose since the first one in known lengths, "
            "(translation, rotation) in camera axes; that of optimised poses is smaller",
        )
        return Written(tuple(wrote), assumed, tuple(left_out))


def upper(covariance: Float | None) -> list[float]:
    """Upper triangle of a covariance (6, 6), row by row; nothing of one that is unknown."""
    if covariance is None or not np.isfinite(covariance).all():
        return []
    return [float(value) for value in covariance[UPPER]]


def _text(values: list[float], size: int) -> list[str]:
    return [f"{value:.9g}" for value in values] or [""] * size
