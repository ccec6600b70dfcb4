"""What is exported: a recording, or a map with the recording that it was made of."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from calm_edge.interchange import InterchangeError
from calm_edge.interchange.export.frame_poses import (
    FramePoses,
    LivePoses,
    of_assistant,
    of_primary,
)
from calm_edge.interchange.export.georeference import Georeference, read_georeference
from calm_edge.recording import schema
from calm_edge.recording.reader import Recording
from calm_edge.recording.time_base import CLOCK_KEY, ORIGIN_KEY, WallClock
from calm_edge.trajectories import folded, read_tum
from calm_edge.types import Float, Int, LocalizerUpdate, Metre, PoseStatus, Trajectory
from device.frame import Eye

MAP, TUM, SUMMARY = "map.ply", "trajectory.tum", "summary.json"


@dataclass(frozen=True, slots=True)
class RecordedDrive:
    """A recording, whose poses may be unknown. path: as the user gave it.

    stamp_ns: added to a time of the recording's clock, it gives the user's own; stamps: what these
    are, in words.
    """

    path: Path
    recording: Recording
    stamp_ns: int
    stamps: str

    @property
    def eyes(self) -> tuple[Eye, ...]:
        """Cameras with frames."""
        return tuple(eye for eye in Eye if self.recording.count(schema.IMAGE_TOPICS[eye]))

    def own_ns(self, t_ns: Int) -> Int:
        """Convert times of the recording's clock to the user's own stamps."""
        return np.asarray(t_ns + self.stamp_ns)


@dataclass(frozen=True, slots=True)
class ExportedDrive(RecordedDrive):
    """A drive with its final poses.

    keyframes: optimised poses of the primary's keyframes, t_ns on the recording's clock. spacing:
    world units per map unit. metre: how well lengths are known. lateness: (S, 2) time and time
    offset [ns] of each sub-map. solved: holds the sub-maps: the recording, or a folder of the map.
    cloud: file of the map. place: where the world lies on the Earth, if known.
    """

    keyframes: Trajectory
    last: LocalizerUpdate
    lateness: Int
    spacing_m: float
    metre: Metre
    solved: Recording
    cloud: Path | None = None
    place: Georeference | None = None

    @property
    def spacing(self) -> float:
        """World units per map unit."""
        return self.spacing_m or 1.0

    @property
    def unit(self) -> str:
        """Unit of lengths, in words."""
        if not self.spacing_m:
            return "camera spacings (their distance, spacing_m, was not given)"
        if self.metre.metric:
            return f"metres, sigma of the scale {100 * self.metre.log_sigma:.1f} %"
        return f"metres of unknown scale ({self.metre.reason or 'not metric'})"

    def exposed_ns(self, t_ns: Int) -> Int:
        """Times of exposure of the assistant's frames stamped t_ns (F,), on the primary's clock."""
        nearest = np.abs(self.lateness[:, 0] - t_ns[:, None]).argmin(1)
        return np.asarray(t_ns + self.lateness[nearest, 1])

    def frame_poses(self) -> dict[Eye, FramePoses]:
        """Poses of all frames of each eye; stamps are of the recording's clock."""
        samples = sorted(self.recording.poses(), key=lambda sample: sample.t_ns)
        tracked = [
            s for s in samples if s.status is not PoseStatus.LOST and np.isfinite(s.T_w_c).all()
        ]
        live = LivePoses(
            np.array([s.t_ns for s in tracked], np.int64),
            np.array([s.T_w_c for s in tracked]).reshape(-1, 4, 4),
            np.array([s.epoch for s in tracked], np.int64),
            np.array([s.covariance[:3, :3] for s in tracked]).reshape(-1, 3, 3),
        )
        poses: dict[Eye, FramePoses] = {}
        for eye in self.eyes:
            t_ns = np.unique(self.recording.frame_times(eye))
            if eye is Eye.PRIMARY:
                k = self.keyframes
                poses[eye] = of_primary(t_ns, k.t_ns, k.T_w_c, live, self.spacing)
            elif Eye.PRIMARY in poses:
                exposed = self.exposed_ns(t_ns)
                poses[eye] = of_assistant(t_ns, exposed, poses[Eye.PRIMARY], self.keyframes.T_p_a)
        return poses


def read_drive(path: Path, recording: Path | None = None) -> ExportedDrive:
    """Open a recording, or a map folder.

    recording: that of the map, if it is not where it was. Raises InterchangeError, RecordingError.
    """
    named, summary = _named(path, recording)
    if summary is None:
        return _of_recording(named)
    # maps of version 0.1.0 have no sub-maps of their own
    own = path / str(summary["submap_folder"]) if summary.get("submap_folder") else None
    return _of_map(path, summary, _of_recording(named, own))


def read_recorded(path: Path, recording: Path | None = None) -> RecordedDrive:
    """Open a recording, or that of a map folder, without its poses; raises as `read_drive`."""
    stored = Recording(_named(path, recording)[0])
    return RecordedDrive(path, stored, *_clock(stored))


def _named(path: Path, recording: Path | None) -> tuple[Path, dict[str, Any] | None]:
    """Recording of a recording or of a map folder, and the latter's summary."""
    if not path.exists():
        raise InterchangeError(f"{path}: not found; give a recording or a folder made by map")
    if not (path.is_dir() and (path / SUMMARY).is_file() and (path / TUM).is_file()):
        return path, None
    summary = _summary(path / SUMMARY)
    named = recording or (Path(summary["recording"]) if summary.get("recording") else None)
    if named is None or not named.exists():
        where = "its summary.json names none" if named is None else f"{named} is not there"
        raise InterchangeError(
            f"{path}: a map is exported with its recording, and {where}; give it by --recording"
        )
    return named, summary


def _of_recording(path: Path, submaps: Path | None = None) -> ExportedDrive:
    """A recording with the sub-maps that it holds, or with those that a map has written."""
    recording = Recording(path)
    solved = recording if submaps is None else Recording(submaps)
    trajectories: list[Trajectory] = []
    lateness: dict[int, tuple[int, int]] = {}
    last: LocalizerUpdate | None = None
    for update in solved.updates():
        trajectories.append(update.trajectory)
        submap = update.submap
        # the last of several updates of a sub-map counts
        lateness[submap.id] = int(np.median(submap.t_ns)), submap.late_ns
        last = update
    keyframes = folded(trajectories)
    if last is None or keyframes is None or not len(keyframes.t_ns):
        recording.check_cameras()
        raise InterchangeError(
            f"{path}: holds no solved window; run calm-edge map first, or record with a backbone"
        )
    order = np.argsort(keyframes.t_ns, kind="stable")
    keyframes = replace(
        keyframes,
        keyframe_ids=keyframes.keyframe_ids[order],
        t_ns=keyframes.t_ns[order],
        T_w_c=keyframes.T_w_c[order],
    )
    return ExportedDrive(
        path,
        recording,
        *_clock(recording),
        keyframes,
        last,
        np.array(list(lateness.values()), np.int64),
        recording.config.scale.spacing_m or 0.0,
        last.metre,
        solved,
    )


def _of_map(path: Path, summary: dict[str, Any], drive: ExportedDrive) -> ExportedDrive:
    """The drive with the poses and the cloud of a map."""
    own_ns, T_w_c = read_tum(path / TUM)
    t_ns = own_ns + drive.recording.origin_ns
    stored = drive.recording.frame_times(Eye.PRIMARY)
    if not np.isin(t_ns, stored).all():
        raise InterchangeError(
            f"{path}: its poses are not at frames of {drive.path}; give the recording of the map "
            "by --recording"
        )
    value = summary.get("metre") or {}
    percent = value.get("sigma_percent")
    metre = Metre(np.inf if percent is None else percent / 100, str(value.get("reason") or ""))
    rig: Float = drive.keyframes.T_p_a
    if summary.get("T_p_a") is not None:
        rig = np.array(summary["T_p_a"], np.float64).reshape(4, 4)
    cloud = path / MAP
    return replace(
        drive,
        path=path,
        keyframes=Trajectory(np.arange(len(t_ns)), t_ns, T_w_c, rig, 0),
        spacing_m=float(summary.get("spacing_m") or 0.0),
        metre=metre,
        cloud=cloud if cloud.is_file() else None,
        place=read_georeference(path),
    )


def _summary(path: Path) -> dict[str, Any]:
    try:
        summary = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise InterchangeError(f"{path}: not readable ({error}); run calm-edge map again") from None
    if not isinstance(summary, dict):
        raise InterchangeError(f"{path}: not a JSON object; run calm-edge map again")
    return summary


def _clock(recording: Recording) -> tuple[int, str]:
    """What converts stamps to the user's own, and what these are in words.

    Stamps of a replay or an import are the source's, those of live cameras Unix time. In
    recordings of version 0.1.0 the latter are of the host's monotonic clock: the last reading of
    the wall clock, which by then is most likely set, dates them.
    """
    metadata = recording.metadata
    if metadata.get(CLOCK_KEY) in (WallClock.SYNCHRONISED, WallClock.UNSYNCHRONISED):
        return -recording.origin_ns, f"of the host's wall clock, {metadata[CLOCK_KEY]}"
    if ORIGIN_KEY not in metadata:
        return 0, "as recorded by an earlier version, which added up to a second to the source's"
    if recording.origin_ns:
        return -recording.origin_ns, "as in the source"
    pairs = list(recording.json_messages(schema.CLOCK))
    if not pairs:
        return 0, "as recorded"
    pair = pairs[-1]
    return int(pair["realtime_ns"]) - int(pair["monotonic_ns"]), "of the host's wall clock"
