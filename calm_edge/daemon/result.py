"""Result of one run of `record`."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from calm_edge.daemon.tick_latency import TickLatency
from calm_edge.frontend.diagnosis import Cause, Kind
from calm_edge.trajectories import folded
from calm_edge.types import Metre, PoseStatus, Trajectory
from device.frame import Eye

# ages kept for the percentiles: an hour at ten poses a second
AGES = 36_000
# parts of the trajectory that are kept apart
PIECES = 64
NO_WINDOW = "there was no window to solve"


@dataclass(slots=True)
class RecordResult:
    """Counts of one run, and its trajectory.

    trajectory: as known when the run ended. finished: all windows were handled and the joint
    optimum was computed.
    lost_windows: ids of windows that the estimator had not finished when it died or was stopped.
    windows_left_to_map: ids of windows not processed for lack of time, left for `calm-edge map`.
    unsolved_windows: ids of windows from which no sub-map could be computed. late_poses: number of
    frames without a pose, because newer ones were waiting. unscaled_poses: number of poses that are
    not metric. clamped_stamps: number of frames with a corrected stamp. output_losses: lost
    messages by output, without the recording. output_faults: why outputs did not work at the end.
    spacing_m: as configured, 0 if not. repeated: frames
    of each camera whose picture repeats the one before. gaps: of the path that nothing connects, as
    line of text, empty if there are none. camera_drops, corrupt: frames that the cameras left out,
    and that could not be used. gps_fixes: with a position. sensor_faults: of
    GPS at the end. host_stamped: frames stamped on arrival. no_window: why the pictures
    gave no window.
    """

    frames: list[int] = field(default_factory=lambda: [0, 0])
    keyframes: int = 0
    windows: int = 0
    submaps: int = 0
    untracked: int = 0
    unreadable: int = 0
    repeated: list[int] = field(default_factory=lambda: [0, 0])
    overflowed: int = 0
    late_ticks: int = 0
    tick: TickLatency = field(default_factory=TickLatency)
    camera_drops: int = 0
    corrupt: int = 0
    clamped_stamps: int = 0
    host_stamped: int = 0
    no_window: tuple[Cause, ...] = ()
    unrecorded: int = 0
    estimator_restarts: int = 0
    tracker_restarts: int = 0
    lost_windows: list[int] = field(default_factory=list)
    windows_left_to_map: list[int] = field(default_factory=list)
    unsolved_windows: list[int] = field(default_factory=list)
    poses: int = 0
    unscaled_poses: int = 0
    lost_poses: int = 0
    late_poses: int = 0
    pose_status: PoseStatus = PoseStatus.LOST
    output_losses: dict[str, int] = field(default_factory=dict)
    output_faults: list[str] = field(default_factory=list)
    trajectory: Trajectory | None = None
    finished: bool = False
    gps_fixes: int = 0
    sensor_faults: list[str] = field(default_factory=list)
    spacing_m: float = 0.0
    metre: Metre = field(default_factory=Metre)
    gaps: str = ""
    error: str = ""
    _worst_age_ms: float | None = None
    _ages_ms: deque[float] = field(default_factory=lambda: deque(maxlen=AGES))
    _pieces: list[Trajectory] = field(default_factory=list)
    _pieces_of: int = 0

    def note_trajectory(self, piece: Trajectory, run: int) -> None:
        """Take poses of keyframes that are new or have moved.

        run: number of the estimator's restarts; each has a world of its own, the newest counts.
        """
        if run != self._pieces_of:
            self._pieces_of = run
            self._pieces.clear()
        self._pieces.append(piece)
        if len(self._pieces) > PIECES:
            self._end_pieces()

    def end_unfinished(self) -> None:
        """Take the newest known poses as the trajectory of a run that did not finish."""
        if not self.finished and self._pieces:
            self._end_pieces()
            self.trajectory = self._pieces[0]

    def _end_pieces(self) -> None:
        joined = folded(self._pieces)
        self._pieces = [] if joined is None else [joined]

    def note_pose(self, status: PoseStatus, age_ms: float | None) -> None:
        """Count a pose. age_ms: time from exposure to publishing, None in lockstep."""
        self.pose_status = status
        if status is PoseStatus.LOST:
            self.lost_poses += 1
        elif status is PoseStatus.UNSCALED:
            self.unscaled_poses += 1
        else:
            self.poses += 1
            if age_ms is not None:
                self._ages_ms.append(age_ms)
                self._worst_age_ms = max(age_ms, self._worst_age_ms or 0.0)

    def no_metre(self) -> str:
        """Why the trajectory is not metric though the spacing was given; empty if it is.

        Of a car that stood still there is nothing to be metric.
        """
        metre = self.final_metre()
        if not self.spacing_m or metre.metric:
            return ""
        return metre.reason or "no window was solved"

    def final_metre(self) -> Metre:
        """The metre of the drive, with a reason for the lack of windows."""
        if self.windows:
            return self.metre
        return Metre(reason="; ".join(cause.text for cause in self.no_window) or NO_WINDOW)

    @property
    def stood(self) -> bool:
        """Whether there was no window because the car did not move."""
        return [cause.kind for cause in self.no_window] == [Kind.STILL]

    def take_worst_age_ms(self) -> float | None:
        """Return the largest pose age since the last call; None without a pose."""
        worst, self._worst_age_ms = self._worst_age_ms, None
        return worst

    def pose_age_ms(self) -> dict[str, float] | None:
        """{p50, p99} [ms] of the time from exposure to publishing; None without a pose."""
        if not self._ages_ms:
            return None
        p50, p99 = np.percentile(self._ages_ms, [50, 99])
        return {"p50": float(p50), "p99": float(p99)}

    def counts(self) -> dict[str, int]:
        """Numbers of frames, keyframes, windows, sub-maps and poses."""
        return {
            "primary_frames": self.frames[0],
            "assistant_frames": self.frames[1],
            "keyframes": self.keyframes,
            "windows": self.windows,
            "submaps": self.submaps,
            "poses": self.poses,
            "unscaled_poses": self.unscaled_poses,
            "lost_poses": self.lost_poses,
            "late_poses": self.late_poses,
            "gps_fixes": self.gps_fixes,
        }

    def losses(self) -> list[str]:
        """One line of text for each kind of loss in the recording or the trajectory."""
        lines = [
            f"no frame of the {eye.name.lower()} camera" for eye in Eye if not self.frames[eye]
        ]
        if not self.windows and all(self.frames) and not self.stood:
            lines.append(f"no window could be made: {self.final_metre().reason}")
        if self.unsolved_windows:
            lines.append(
                f"windows {self.unsolved_windows} could not be solved; constant velocity is "
                "assumed there"
            )
        if self.estimator_restarts:
            lines.append(
                "the estimator was restarted, the trajectory is incomplete; run calm-edge map"
            )
        if self.tracker_restarts:
            lines.append("the tracker was restarted; at most one window was lost each time")
        if self.lost_windows:
            lines.append(f"windows {self.lost_windows} were not solved; run calm-edge map")
        if self.windows_left_to_map:
            lines.append(f"{len(self.windows_left_to_map)} windows were skipped; run calm-edge map")
        if self.submaps and not self.finished:
            lines.append("stopped before all poses were optimised; run calm-edge map")
        if self.unrecorded:
            lines.append(f"{self.unrecorded} items could not be recorded")
        if self.camera_drops:
            lines.append(f"{self.camera_drops} frames were left out by the cameras")
        if self.corrupt:
            lines.append(f"{self.corrupt} frames came corrupt from the cameras")
        if self.untracked:
            lines.append(f"{self.untracked} frames were recorded but not tracked in time")
        if self.unreadable:
            lines.append(f"{self.unreadable} frames were not readable")
        if self.gaps:
            lines.append(self.gaps)
        lines += [f"output: {fault}" for fault in self.output_faults]
        lines += [f"fixes: {fault}" for fault in self.sensor_faults]
        if self.overflowed:
            lines.append(f"{self.overflowed} frames came faster than they could be read")
        return lines

    def summary(self) -> dict[str, Any]:
        """JSON object for the topic /status of the recording at the end of a run."""
        return {
            "frames": list(self.frames),
            **self.counts(),
            "pose_age_ms": self.pose_age_ms(),
            "untracked": self.untracked,
            "repeated": list(self.repeated),
            "gaps": self.gaps,
            "camera_drops": self.camera_drops,
            "corrupt": self.corrupt,
            "clamped_stamps": self.clamped_stamps,
            "host_stamped": self.host_stamped,
            "late_ticks": self.late_ticks,
            "tick_p99_ms": self.tick.p99_ms,
            "estimator_restarts": self.estimator_restarts,
            "tracker_restarts": self.tracker_restarts,
            "lost_windows": list(self.lost_windows),
            "windows_left_to_map": list(self.windows_left_to_map),
            "metre": self.final_metre().summary(),
            "finished": self.finished,
            "unsolved_windows": list(self.unsolved_windows),
            "output_losses": dict(self.output_losses),
            "losses": self.losses(),
        }
