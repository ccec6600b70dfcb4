"""Collect the report of a recording: what `record` estimated, and what the recording holds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from calm_edge.evaluation.estimate import recorded
from calm_edge.evaluation.truth import Truth
from calm_edge.recording.reader import Recording
from calm_edge.recording.retention import TRAJECTORY_FILE
from calm_edge.recording.segment import recording_files
from calm_edge.report.drive_log import read_log
from calm_edge.report.drive_report import compared, report_data
from calm_edge.report.events import marked_events
from calm_edge.report.keyframe_pictures import late_pictures
from calm_edge.report.report import ReportData


def recording_report(recording: Recording, truth: Truth | None, page: Path) -> ReportData:
    """The report's data. page: where it is written. Raises RecordingError."""
    updates = list(recording.updates())
    estimate = recorded(recording, updates)
    figures, truth, notes = compared(estimate, truth)
    notes += recording.losses
    notes += [text for update in updates for text in update.notices]
    zero_ns = int(estimate.t_ns[0]) if len(estimate.t_ns) else None
    log = read_log(recording, zero_ns, estimate.live)
    notes += [str(line) for line in log.counts.get("losses", ())]
    path = recording.path.resolve()
    data = report_data(
        f"{path.parent.name}/{path.name}",
        estimate,
        updates,
        truth=truth,
        figures=figures,
        notes=list(dict.fromkeys(notes)),
        pictures=late_pictures(recording, list(recording.windows())),
        log=log,
        events=marked_events(recording.events(), estimate.t_ns, estimate.T_w_c),
    )
    maps = () if recording.path.is_file() else (recording.path / TRAJECTORY_FILE,)
    return replace(data, files=(*recording_files(recording.path), *maps))
