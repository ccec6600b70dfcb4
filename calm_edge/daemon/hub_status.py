"""Counters and queue lengths of the hub, which the monitor reads once a second."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from calm_edge.daemon.estimator_link import EstimatorLink
from calm_edge.daemon.fan_out import FanOut
from calm_edge.daemon.result import RecordResult
from calm_edge.daemon.sensor import Sensor
from calm_edge.daemon.tracker_link import TrackerLink
from calm_edge.recording.health import WriterHealth
from calm_edge.types import PoseStatus


@dataclass(frozen=True, slots=True)
class HubStatus:
    """Status of the hub at now_ns, on the clock of the frames' stamps.

    frame_ns: time of the last frame of each camera. pose_ns: time of the last live pose.
    pose_lost: the newest pose has the status LOST. no_metre: why there is no sub-map, or why the
    newest pose is not metric though the spacing is configured; else empty. pose_age_ms: largest age
    of a pose in this second. windows_overtaken: number skipped to process newer ones. faults: one
    line for each part that does not work. counts, drops: numbers of items, and of losses by cause,
    since the start. queues: lengths by name. stage_ms: durations of the newest window's stages.
    """

    now_ns: int
    frame_ns: tuple[int, int]
    pose_ns: int
    pose_lost: bool
    no_metre: str
    pose_age_ms: float | None
    windows_waiting: int
    windows_overtaken: int
    faults: tuple[str, ...]
    counts: dict[str, int]
    drops: dict[str, int]
    queues: dict[str, float]
    stage_ms: dict[str, float]
    writer: WriterHealth


def take_status(
    result: RecordResult,
    tracker: TrackerLink,
    estimator: EstimatorLink,
    outputs: FanOut,
    writer: WriterHealth,
    sensors: Sequence[Sensor],
    *,
    now_ns: int,
    frame_ns: tuple[int, int],
    pose_ns: int,
    stage_ms: dict[str, float],
) -> HubStatus:
    """Return the status at now_ns, and reset the largest pose age in `result`."""
    links = {"estimator": estimator.given_up, "tracker": tracker.given_up}
    sensor_faults = filter(None, (sensor.fault for sensor in sensors))
    refused = [estimator.refused] if estimator.refused else []
    given_up = [f"{name} failed, not restarted" for name, gone in links.items() if gone]
    return HubStatus(
        now_ns,
        frame_ns,
        pose_ns,
        result.pose_status is PoseStatus.LOST,
        _no_metre(result),
        result.take_worst_age_ms(),
        estimator.waiting,
        estimator.overtaken,
        (*outputs.faults(), *sensor_faults, *given_up, *refused),
        result.counts(),
        {
            "images_not_recorded": writer.dropped_images,
            "others_not_recorded": writer.dropped_others + writer.unwritable,
            "not_tracked": result.untracked + tracker.frames_lost,
            "unreadable": result.unreadable,
            "repeated": sum(result.repeated),
            "windows_left_to_map": len(estimator.left_to_map),
            "windows_lost": len(estimator.lost),
            "windows_unsolved": len(estimator.unsolved),
            **{f"{name}_messages": lost for name, lost in outputs.lost().items()},
        },
        {
            "tracker_frames": tracker.in_flight,
            "tracker_submaps": tracker.attaching,
            "estimator_windows": estimator.waiting,
            "recording_fill": writer.queue_fill,
        },
        stage_ms,
        writer,
    )


def _no_metre(result: RecordResult) -> str:
    reason = result.metre.reason
    if not result.spacing_m:
        return ""
    if result.pose_status is PoseStatus.UNSCALED:
        # the drive may have a metre that its newest sub-map lacks
        return f"no metre: {reason or 'the newest sub-map does not show it'}"
    return f"no metre: {reason}" if reason and not result.submaps else ""
