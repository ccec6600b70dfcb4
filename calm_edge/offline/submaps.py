"""Sub-maps of a recording in their final placement, as recorded or computed again.

What `record` solved is used. Windows without a sub-map are solved, and so are again, from their
pictures, those that were matched before the kit was known; then all are placed again. If the
backbone estimates no kit and a sub-map is missing, all windows are computed again in order.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace

from calm_edge.backbones.base import ResolvingBackbone
from calm_edge.backbones.registry import open_backbone
from calm_edge.config import Config, merge
from calm_edge.estimator.localizer import Localizer
from calm_edge.frontend.association import WindowBuilder
from calm_edge.frontend.diagnosis import of_frames
from calm_edge.frontend.keyframes import KeyframeSelector
from calm_edge.frontend.picture_sizes import PictureSizes
from calm_edge.offline.completion import completed, due
from calm_edge.offline.drive import Drive, Logged, with_poses
from calm_edge.offline.progress import Progress
from calm_edge.offline.unfinished import Unfinished
from calm_edge.recording import RecordingError
from calm_edge.recording.reader import Recording
from calm_edge.recording.schema import STATUS
from calm_edge.recording.window_record import WindowRecord, of_window
from calm_edge.trajectories import folded
from calm_edge.types import (
    LocalizerUpdate,
    SubmapWindow,
    Trajectory,
)
from device.frame import Eye, UnreadableImage


def gather(
    recording: Recording,
    config: Config,
    say: Callable[[str], None],
    unfinished: Unfinished | None = None,
    *,
    again: bool = False,
) -> Drive:
    """Return the placed windows of a recording, solved where `record` did not do it.

    These are windows without a sub-map, and those matched before the kit was known. unfinished:
    keeps what is solved, and has what an interrupted run has solved. again: solve all windows.
    """
    records = {record.submap_id: record for record in recording.windows()}
    if not records:
        if not len(recording.frame_times(Eye.PRIMARY)):
            return Drive()
        say("the recording holds no windows: selecting keyframes again")
        return _recompute(recording, records, config, say)
    if again:
        return _recompute(recording, records, config, say)
    logged = _logged(recording, records)
    solved = unfinished.solved() if unfinished is not None else {}
    if logged.complete and not due(records, logged):
        return logged.drive(records)
    # the kit file may already contain the evidence of this drive
    config = merge(config, {"backbone": {"kit_file": ""}})
    backbone = open_backbone(config)
    # sections V-A and V-B learn from the images of every window
    restores = isinstance(backbone, ResolvingBackbone) and config.correction.apply != "always"
    keep = unfinished.add if unfinished is not None and restores else _not_kept
    if solved and restores:
        say(f"{len(solved)} windows were solved by an interrupted run")
        logged, records = _with_solved(logged, records, solved)
    if logged.updates and restores:
        localizer = Localizer(config, backbone)
        return completed(recording, config, records, logged, localizer, say, keep)
    if logged.complete:
        return logged.drive(records)
    return _recompute(recording, records, config, say, keep)


def _not_kept(record: WindowRecord, update: LocalizerUpdate) -> None:
    """Nothing is kept of a window whose solution cannot be restored."""


def _with_solved(
    logged: Logged,
    records: dict[int, WindowRecord],
    solved: Mapping[int, tuple[WindowRecord, LocalizerUpdate]],
) -> tuple[Logged, dict[int, WindowRecord]]:
    """Add the windows that an interrupted run has solved to those that `record` has."""
    updates = {**logged.updates, **{i: update for i, (_, update) in solved.items()}}
    in_order = {i: updates[i] for i in sorted(updates)}
    records = {**records, **{i: record for i, (record, _) in solved.items()}}
    return replace(logged, updates=in_order, later=frozenset(solved)), records


def _logged(recording: Recording, records: dict[int, WindowRecord]) -> Logged:
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
    unsolved = {int(i) for i in ids} if isinstance(ids, list) else set()
    # a restarted estimator has a new world frame, unrelated to the earlier one
    finished = bool(status.get("finished")) and not status.get("estimator_restarts")
    updates = {i: _final(first[i], last[i]) for i in sorted(set(records) & set(last))}
    complete = finished and not set(records) - set(updates) - unsolved
    return Logged(updates, folded(pieces), finished, complete)


def _final(first: LocalizerUpdate, last: LocalizerUpdate) -> LocalizerUpdate:
    """Combine the first and the last update of a sub-map.

    Only the first has the loop closure, and the landmarks, unless the window was solved again from
    its pictures; they are moved to the poses and cameras of the last.
    """
    solved = last.prediction if last.prediction.landmarks is not None else first.prediction
    prediction = with_poses(solved, last.submap.cameras_raw, last.submap.T_s_c_raw)
    loop = last.loop or first.loop
    return replace(last, prediction=prediction, stage_ms=first.stage_ms, loop=loop)


def _recompute(
    recording: Recording,
    records: dict[int, WindowRecord],
    config: Config,
    say: Callable[[str], None],
    keep: Callable[[WindowRecord, LocalizerUpdate], None] = _not_kept,
) -> Drive:
    config = merge(config, {"backbone": {"kit_file": ""}})
    localizer = Localizer(config, open_backbone(config))
    drive = Drive()
    found: dict[int, tuple[WindowRecord, LocalizerUpdate]] = {}
    progress = Progress("solving windows", len(records) or None, say)
    for window in _windows(recording, records, config, drive):
        update = localizer.process(window)
        progress.step()
        if update is None:
            drive.unsolved.append(window.submap_id)
            pictures = (tuple(k.frame for k in eye) for eye in (window.primary, window.assistant))
            reasons = [localizer.skipped[-1].reason, *(c.text for c in of_frames(*pictures))]
            say(f"window {window.submap_id}: {'; '.join(reasons)}")
            continue
        light = replace(update.prediction, depth=None, confidence=None)
        # the loop keyframe found now may differ from the recorded one
        solved = replace(window, loop_keyframe=update.loop_keyframe)
        found[window.submap_id] = of_window(solved), replace(update, prediction=light)
        keep(*found[window.submap_id])
    drive.trajectory = localizer.finish()
    drive.metre = localizer.metre
    for submap in localizer.submaps:
        record, update = found[submap.id]
        prediction = with_poses(update.prediction, submap.cameras_raw, submap.T_s_c_raw)
        drive.windows.append(record)
        update = replace(
            update,
            submap=submap,
            prediction=prediction,
            metre=drive.metre,
            masks=localizer.masks,
        )
        drive.updates.append(update)
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
    sizes = PictureSizes()
    for frame in recording.frames():
        try:
            resized = sizes.change(frame)
        except UnreadableImage as error:
            drive.losses.append(str(error))
            continue
        if resized:
            yield from builder.cut()
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
