"""Calibration given to a rival: the true one, or one with a wrong parameter."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calm_edge.evaluation import EvaluationError
from calm_edge.evaluation.truth import read_truth
from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera
from calm_edge.recording.sequence_folder import SequenceFolder
from calm_edge.trajectories import read_kitti
from calm_edge.types import Float, Int
from device.frame import Eye


@dataclass(frozen=True, slots=True)
class Calibration:
    """Calibration of a stereo rig.

    cameras: one per eye. T_p_a: (4, 4) assistant -> primary, metres. size: (width, height) px.
    """

    cameras: tuple[Camera, Camera]
    T_p_a: Float
    size: tuple[int, int]

    def with_focal(self, factor: float) -> Calibration:
        """Scale both focal lengths and keep the principal points."""
        primary, assistant = (replace(c, fx=c.fx * factor, fy=c.fy * factor) for c in self.cameras)
        return replace(self, cameras=(primary, assistant))

    def with_yaw(self, degrees: float) -> Calibration:
        """Rotate the assistant to the right by an angle."""
        T = self.T_p_a.copy()
        T[:3, :3] = T[:3, :3] @ se3.so3_exp(np.array([0.0, np.radians(degrees), 0.0]))
        return replace(self, T_p_a=T)


def true_calibration(folder: Path, spacing_m: float | None = None) -> Calibration:
    """Calibration of a sequence folder from `calib.txt` and `poses1.txt`.

    The rig is the mean of T_w_p(t1)^-1 T_w_a(t1) over the assistant's stamps t1, with the primary's
    poses interpolated. Without `poses1.txt` the pictures are assumed rectified, with cameras
    `spacing_m` apart along x. Raises EvaluationError if neither is given.
    """
    truth, sequence = read_truth(folder), SequenceFolder(folder)
    if truth.cameras is None:
        raise EvaluationError(f"{folder / 'calib.txt'}: missing; a rival needs the calibration")
    size = sequence.size(Eye.PRIMARY)
    if sequence.size(Eye.ASSISTANT) != size:
        raise EvaluationError(f"{folder}: the pictures of both cameras must have the same size")
    if (folder / "poses1.txt").is_file():
        T_w_a = read_kitti(folder / "poses1.txt")
        t = sequence.t_ns(Eye.ASSISTANT)
        inside = (t >= truth.t_ns[0]) & (t <= truth.t_ns[-1])
        seconds = (truth.t_ns - truth.t_ns[0]) / 1e9
        T_w_p = se3.interpolate_at(seconds, truth.T_w_c, (t[inside] - truth.t_ns[0]) / 1e9)
        return Calibration(truth.cameras, se3.mean(se3.inverse(T_w_p) @ T_w_a[inside]), size)
    if spacing_m is None:
        raise EvaluationError(f"{folder}: no poses1.txt and no spacing, so the rig is unknown")
    T_p_a = np.eye(4)
    T_p_a[0, 3] = spacing_m
    return Calibration(truth.cameras, T_p_a, size)


def nearest_pairs(t_primary: Int, t_assistant: Int, shift: int = 0) -> Int:
    """Indices (N, 2) of primary frames and of the assistant frames nearest in time.

    shift: added to the assistant's index. t_primary (P,), t_assistant (A,): ns, sorted. Pairs
    outside the assistant's stream are left out.
    """
    right = np.clip(np.searchsorted(t_assistant, t_primary), 1, max(len(t_assistant) - 1, 1))
    right = np.minimum(right, len(t_assistant) - 1)
    left = np.maximum(right - 1, 0)
    nearer = np.abs(t_primary - t_assistant[left]) <= np.abs(t_assistant[right] - t_primary)
    partner = np.where(nearer, left, right) + shift
    inside = (partner >= 0) & (partner < len(t_assistant))
    return np.stack([np.flatnonzero(inside), partner[inside]], 1)
