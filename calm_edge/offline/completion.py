"""Solve what `record` left: windows without a sub-map, or matched before the kit was known."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace

import numpy as np

from calm_edge.config import Config
from calm_edge.estimator.held_windows import unsettled, worth_solving
from calm_edge.estimator.localizer import Localizer
from calm_edge.estimator.window_solver import Reconstruction
from calm_edge.offline.drive import Drive, Logged, with_poses
from calm_edge.offline.progress import Progress
from calm_edge.recording import RecordingError
from calm_edge.recording.reader import Recording
from calm_edge.recording.window_record import WindowRecord, of_window, window_hints
from calm_edge.types import LocalizerUpdate, Submap, Trajectory
from device.frame import Eye, UnreadableImage


def due(records: dict[int, WindowRecord], logged: Logged) -> list[int]:
    """Ids of the windows that may have to be solved, in order."""
    settled = [i for i, update in logged.updates.items() if not unsettled(update.prediction)]
    return sorted(set(records) - set(settled))


def completed(
    recording: Recording,
    config: Config,
    records: dict[int, WindowRecord],
    logged: Logged,
    localizer: Localizer,
    say: Callable[[str], None],
    keep: Callable[[WindowRecord, LocalizerUpdate], None],
) -> Drive:
    """Solve the windows that are `due` with all that the others show of the kit; place all again.

    localizer: a new one. keep: called with each solved window. The drive as logged if no window is
    solved.
    """
    drive = Drive()
    missing = set(records) - set(logged.updates) if not logged.complete else set()
    _restore(recording, config, records, logged, localizer, places=bool(missing))
    if missing:
        say(f"{len(missing)} of {len(records)} windows have no sub-map yet and are solved now")
    solved: dict[int, Reconstruction] = {}
    todo = due(records, logged)
    progress = Progress("solving windows", len(todo), say)
    for i in todo:
        if i in logged.updates and not _worth_solving(logged.updates[i], localizer):
            progress.leave_out()
            continue
        try:
            found = localizer.attempt(recording.window(records[i]))
        except RecordingError as error:
            drive.losses.append(f"window {i}: {error}")
            found = None
        if found is not None:
            solved[i] = found
            keep(*_solved(found, logged.updates.get(i)))
        progress.step()
    if logged.complete and not (solved or logged.later):
        return logged.drive(records)
    say("placing all sub-maps")
    drive.trajectory = localizer.finish()
    drive.metre = localizer.metre
    for submap in localizer.submaps:
        record, update = _result(submap, records, logged, solved, localizer, drive.trajectory)
        drive.windows.append(record)
        drive.updates.append(replace(update, metre=drive.metre, masks=localizer.masks))
    if drive.trajectory is not None:
        drive.updates[-1] = replace(drive.updates[-1], trajectory=drive.trajectory)
    drive.unsolved = sorted(set(records) - {submap.id for submap in localizer.submaps})
    return drive


def _restore(
    recording: Recording,
    config: Config,
    records: dict[int, WindowRecord],
    logged: Logged,
    localizer: Localizer,
    *,
    places: bool,
) -> None:
    """Give the logged sub-maps to the localizer. places: also to its loop search."""
    sizes = np.array([recording.picture_size(eye) for eye in Eye], np.int64)
    for i, update in logged.updates.items():
        hints = replace(window_hints(records[i], update, config), sizes=sizes)
        localizer.restore(update, hints, final=logged.finished and i not in logged.later)
        if places and config.loops.enabled:
            with suppress(RecordingError, UnreadableImage):
                localizer.remember(recording.window(records[i]))


def _solved(
    found: Reconstruction, update: LocalizerUpdate | None
) -> tuple[WindowRecord, LocalizerUpdate]:
    """Record and update of a window as solved, not yet placed. update: as recorded."""
    submap = found.submap
    if update is None:
        path = submap.T_s_c[: submap.n_primary]
        nowhere = Trajectory(
            np.array(submap.primary_ids), submap.t_ns[: submap.n_primary], path, np.eye(4), 0
        )
        update = LocalizerUpdate(submap, found.prediction, nowhere, loop=found.closed)
    loop = found.closed or update.loop
    return of_window(found.window), replace(
        update, submap=submap, prediction=found.prediction, loop=loop
    )


def _worth_solving(update: LocalizerUpdate, localizer: Localizer) -> bool:
    before, now = update.prediction.kit_sigma, localizer.kit_sigma(update.submap.id)
    return before is not None and now is not None and worth_solving(before, now, final=True)


def _result(
    submap: Submap,
    records: dict[int, WindowRecord],
    logged: Logged,
    solved: dict[int, Reconstruction],
    localizer: Localizer,
    trajectory: Trajectory | None,
) -> tuple[WindowRecord, LocalizerUpdate]:
    """Record and update of a sub-map in its final placement."""
    i = submap.id
    record, update, new = records[i], logged.updates.get(i), solved.get(i)
    late = localizer.solved_again.get(i)
    if update is None:
        assert trajectory is not None and (new is not None or late is not None)
        prediction = new.prediction if new is not None else late
        assert prediction is not None
        update = LocalizerUpdate(submap, prediction, trajectory, kit=localizer.kit)
    if new is not None:
        record = of_window(new.window)
        update = replace(update, loop=new.closed or update.loop, prediction=new.prediction)
    prediction = late if late is not None else update.prediction
    prediction = with_poses(prediction, submap.cameras_raw, submap.T_s_c_raw)
    return record, replace(update, submap=submap, prediction=prediction)
