"""Sub-maps of a recording in their final placement, as recorded or computed again.

Recorded results are used if `record` finished and each solved window has its sub-map. Otherwise all
windows are computed again in order; the Localizer is a deterministic function of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from calm_edge.backbones.registry import open_backbone
from calm_edge.config import Config, merge
from calm_edge.estimator.localizer import Localizer
from calm_edge.frontend.association import WindowBuilder
from calm_edge.frontend.keyframes import KeyframeSelector
from calm_edge.geometry.camera import Camera, back_project_each
from calm_edge.recording import RecordingError
from calm_edge.recording.reader import Recording
from calm_edge.recording.schema import STATUS
from calm_edge.recording.window_record import WindowRecord, of_window
from calm_edge.trajectories import folded
from calm_edge.types import (
    Float,
    Landmarks,
    LocalizerUpdate,
    Prediction,
    SubmapWindow,
    Trajectory,
)
from device.frame import Eye, UnreadableImage


@dataclass(slots=True)
class Drive:
    """Solved windows of a drive in order of time, and the update of each at the same index.

    unsolved: ids of windows that could not be solved. losses: one line for each missing part.
    """

    windows: list[WindowRecord] = field(default_factory=list)
    updates: list[LocalizerUpdate] = field(default_factory=list)
    trajectory: Trajectory | None = None
    unsolved: list[int] = field(default_factory=list)
    losses: list[str] = field(default_factory=list)


def gather(recording: Recording, config: Config, say: Callable[[str], None]) -> Drive:
    """Return the placed windows of a recording, computed again where `record` did not finish."""
    records = {record.submap_id: record for record in recording.windows()}
    drive = _logged(recording, records)
    if drive is None:
        if not records and not len(recording.frame_times(Eye.PRIMARY)):
            return Drive()
        if not records:
            say("the recording holds no windows: selecting keyframes again")
        drive = _recompute(recording, records, config, say)
    return drive


def _logged(recording: Recording, records: dict[int, WindowRecord]) -> Drive | None:
    """Return the results recorded by `record`; None if they do not cover every window."""
    status: dict[str, object] = {}
    for message in recording.json_messages(STATUS):
        status = message if "finished" in message else status
    first: dict[int, LocalizerUpdate] = {}
    last: dict[int, LocalizerUpdate] = {}
    pieces: list[Trajectory] = []
    for update in recording.updates():
        first.setdefault(update.submap.id, update)
        last[update.submap.id] = update
        pieces.append(update.trajectory)
    ids = status.get("unsolved_windows")
    unsolved = [int(i) for i in ids] if isinstance(ids, list) else []
    # a restarted estimator has a new world frame, unrelated to the earlier one
    if status.get("estimator_restarts") or not (status.get("finished") and records):
        return None
    if set(records) - set(last) - set(unsolved):
        return None
    solved = sorted(set(records) & set(last))
    updates = [_final(first[i], last[i]) for i in solved]
    return Drive([records[i] for i in solved], updates, folded(pieces), unsolved=unsolved)


def _final(first: LocalizerUpdate, last: LocalizerUpdate) -> LocalizerUpdate:
    """Combine the first and the last update of a sub-map.

    Only the first has the landmarks; they are moved to the poses and cameras of the last.
    """
    prediction = with_poses(first.prediction, last.submap.cameras_raw, last.submap.T_s_c_raw)
    return replace(last, prediction=prediction, stage_ms=first.stage_ms)


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


def _recompute(
    recording: Recording,
    records: dict[int, WindowRecord],
    config: Config,
    say: Callable[[str], None],
) -> Drive:
    # the kit file may already contain the evidence of this drive
    config = merge(config, {"backbone": {"kit_file": ""}})
    localizer = Localizer(config, open_backbone(config))
    drive = Drive()
    found: dict[int, tuple[WindowRecord, LocalizerUpdate]] = {}
    for window in _windows(recording, records, config, drive):
        update = localizer.process(window)
        if update is None:
            drive.unsolved.append(window.submap_id)
            continue
        light = replace(update.prediction, depth=None, confidence=None)
        # the loop keyframe found now may differ from the recorded one
        solved = replace(window, loop_keyframe=update.loop_keyframe)
        found[window.submap_id] = of_window(solved), replace(update, prediction=light)
        say(f"window {window.submap_id} computed again")
    drive.trajectory = localizer.finish()
    for submap in localizer.submaps:
        record, update = found[submap.id]
        prediction = with_poses(update.prediction, submap.cameras_raw, submap.T_s_c_raw)
        drive.windows.append(record)
        drive.updates.append(replace(update, submap=submap, prediction=prediction))
    if drive.updates and drive.trajectory is not None:
        drive.updates[-1] = replace(drive.updates[-1], trajectory=drive.trajectory)
    return drive


def _windows(
    recording: Recording, records: dict[int, WindowRecord], config: Config, drive: Drive
) -> Iterator[SubmapWindow]:
    """Yield the recorded windows with their images; if there are none, select them again."""
    if not records:
        yield from _chosen_again(recording, config, drive)
        return
    for _, record in sorted(records.items()):
        try:
            yield recording.window(record)
        except RecordingError as error:
            drive.losses.append(f"window {record.submap_id}: {error}")


def _chosen_again(recording: Recording, config: Config, drive: Drive) -> Iterator[SubmapWindow]:
    selector, builder = KeyframeSelector(config.frontend), WindowBuilder(config.frontend)
    for frame in recording.frames():
        if frame.eye is Eye.ASSISTANT:
            yield from builder.add_assistant(frame)
            continue
        try:
            keyframe = selector.consider(frame, frame.gray())
        except UnreadableImage as error:
            drive.losses.append(str(error))
            continue
        yield from builder.advance(frame.t_ns)
        if keyframe is not None:
            yield from builder.add_keyframe(keyframe)
    yield from builder.flush()
