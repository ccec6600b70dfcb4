"""A drive's solved windows with their final poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from calm_edge.config import Config
from calm_edge.estimator import gaps
from calm_edge.geometry.camera import Camera, back_project_each
from calm_edge.recording.window_record import WindowRecord
from calm_edge.types import Float, Landmarks, LocalizerUpdate, Metre, Prediction, Trajectory

UNRECORDED = "the recording is of a version that did not estimate how well lengths are known"


@dataclass(slots=True)
class Drive:
    """Solved windows of a drive in order of time, and the update of each at the same index.

    unsolved: ids of windows that could not be solved. losses: one line for each missing part.
    metre: how well the drive's lengths are known.
    """

    windows: list[WindowRecord] = field(default_factory=list)
    updates: list[LocalizerUpdate] = field(default_factory=list)
    trajectory: Trajectory | None = None
    unsolved: list[int] = field(default_factory=list)
    losses: list[str] = field(default_factory=list)
    metre: Metre = field(default_factory=Metre)

    def gaps(self, config: Config) -> tuple[gaps.Gap, ...]:
        """Gaps of the path that no picture and no loop connects."""
        scale = config.scale
        loops = [update.loop for update in self.updates if update.loop is not None]
        submaps = [update.submap for update in self.updates]
        sigma = gaps.acceleration(scale.spacing, metric=bool(scale.spacing_m))
        return gaps.find(submaps, loops, sigma)

    def missing(self, config: Config) -> list[str]:
        """A line for each loss, for the gaps, and for the windows that could not be solved."""
        lines = list(self.losses)
        if (found := self.gaps(config)) and self.trajectory is not None:
            metric = bool(config.scale.spacing_m)
            lines.append(gaps.described(found, int(self.trajectory.t_ns[0]), metric=metric))
        if self.unsolved:
            lines.append(
                f"windows {self.unsolved} could not be solved; constant velocity is assumed there"
            )
        return lines


@dataclass(frozen=True, slots=True)
class Logged:
    """The results recorded by `record`: updates by sub-map id.

    finished: `record` finished. complete: and each window has a sub-map or could not be solved.
    later: ids of windows solved since, by an earlier run of `map`.
    """

    updates: dict[int, LocalizerUpdate]
    trajectory: Trajectory | None
    finished: bool
    complete: bool
    later: frozenset[int] = frozenset()

    def drive(self, records: dict[int, WindowRecord]) -> Drive:
        """The drive as recorded."""
        unsolved = sorted(set(records) - set(self.updates))
        windows = [records[i] for i in self.updates]
        updates = list(self.updates.values())
        metre = updates[-1].metre if updates else Metre()
        if not (metre.metric or metre.reason):
            metre = Metre(reason=UNRECORDED)
        return Drive(windows, updates, self.trajectory, unsolved, metre=metre)


def with_poses(prediction: Prediction, cameras: tuple[Camera, ...], T_s_c: Float) -> Prediction:
    """Move a prediction to other cameras and poses T_s_c (N, 4, 4) of its views.

    Landmarks are triangulated again; depth is dropped, since it belongs to the old poses.
    """
    if prediction.cameras == cameras and np.array_equal(prediction.T_s_c, T_s_c):
        return prediction
    marks = prediction.landmarks
    if marks is not None:
        marks = replace(marks, points_s=triangulated(marks, cameras, T_s_c))
    return replace(
        prediction, cameras=cameras, T_s_c=T_s_c, landmarks=marks, depth=None, confidence=None
    )


def triangulated(marks: Landmarks, cameras: Sequence[Camera], T_s_c: Float) -> Float:
    """Triangulate landmarks again: points (M, 3) closest to the rays of their observations.

    cameras, T_s_c (N, 4, 4): of all N views. Points with parallel rays are left unchanged.
    """
    uv = marks.uv.astype(np.float64)
    rays = back_project_each(cameras, marks.view, uv, np.ones(len(uv)))
    d = (T_s_c[marks.view, :3, :3] @ rays[..., None])[..., 0]
    d /= np.linalg.norm(d, axis=-1, keepdims=True)
    across = np.eye(3) - d[:, :, None] * d[:, None, :]
    A = np.zeros((len(marks.points_s), 3, 3))
    b = np.zeros((len(marks.points_s), 3))
    np.add.at(A, marks.index, across)
    np.add.at(b, marks.index, (across @ T_s_c[marks.view, :3, 3, None])[..., 0])
    points = np.array(marks.points_s)
    fixed = np.linalg.eigvalsh(A)[:, 0] > 1e-6
    points[fixed] = np.linalg.solve(A[fixed], b[fixed][..., None])[..., 0]
    return points
