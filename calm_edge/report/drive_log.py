"""What a recording says of its drive besides the path: date, version, health, losses."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from calm_edge.recording.reader import Recording
from calm_edge.recording.schema import HEALTH, STATUS
from calm_edge.recording.time_base import CLOCK_KEY, WallClock
from calm_edge.types import Float, PoseSample, PoseStatus
from device.frame import Eye

# shorter times without a pose are frames that were late, not a loss
MIN_LOST_S = 0.5
DATED = (WallClock.SYNCHRONISED, WallClock.UNSYNCHRONISED, WallClock.SOURCE)


@dataclass(frozen=True, slots=True)
class Lost:
    """Time without a live pose. start_s: since the first keyframe. why: as the daemon gave it."""

    start_s: float
    seconds: float
    why: str = ""


@dataclass(frozen=True, slots=True)
class HealthSeries:
    """Health over time; (H,) each, NaN where unknown. t_s: since the first keyframe.

    lost_frames: lost, or recorded and not tracked in time, since the start. states: of the daemon.
    reasons: why it was in that state.
    """

    t_s: Float
    celsius: Float
    free_gb: Float
    written_mb_s: Float
    pose_age_ms: Float
    lost_frames: Float
    states: tuple[str, ...] = ()
    reasons: tuple[tuple[str, ...], ...] = ()


@dataclass(frozen=True, slots=True)
class DriveLog:
    """Facts of one recording.

    started_s: Unix time of the first frame, None if its stamps are no dates. dated_by: where the
    date comes from. duration_s: from the first frame to the last. frames: of each camera. counts:
    what `record` counted at its end, empty if it did not end. rows: name -> text for the table of
    facts. lost: times without a live pose.
    """

    started_s: float | None = None
    dated_by: str = ""
    duration_s: float = 0.0
    frames: tuple[int, int] = (0, 0)
    version: str = ""
    counts: Mapping[str, Any] = field(default_factory=dict)
    rows: Mapping[str, str] = field(default_factory=dict)
    health: HealthSeries | None = None
    lost: tuple[Lost, ...] = ()


def read_log(recording: Recording, zero_ns: int | None, poses: Sequence[PoseSample]) -> DriveLog:
    """Read the facts of a recording.

    zero_ns: stamp of the first keyframe, from which times count; None: of the first frame. poses:
    the live ones, sorted by stamp.
    """
    times = [recording.frame_times(eye) for eye in Eye]
    known = np.concatenate(times)
    first, last = (int(known.min()), int(known.max())) if len(known) else (0, 0)
    zero = first if zero_ns is None else zero_ns
    metadata = recording.metadata
    clock = metadata.get(CLOCK_KEY, "")
    dated = clock in {kind.value for kind in DATED} and len(known) > 0
    health = _health(recording.timed_json_messages(HEALTH), zero)
    counts: Mapping[str, Any] = {}
    for status in recording.json_messages(STATUS):
        counts = status if "finished" in status else counts
    return DriveLog(
        (first - recording.origin_ns) / 1e9 if dated else None,
        clock,
        (last - first) / 1e9,
        (len(times[0]), len(times[1])),
        metadata.get("version", ""),
        counts,
        _rows(recording, metadata),
        health,
        lost_spans(poses, zero, health),
    )


def lost_spans(
    poses: Sequence[PoseSample], zero_ns: int, health: HealthSeries | None
) -> tuple[Lost, ...]:
    """Times of at least MIN_LOST_S in which poses are LOST, with the daemon's usual reason then."""
    spans: list[Lost] = []
    start: int | None = None
    for index, sample in enumerate(poses):
        lost = sample.status is PoseStatus.LOST
        if lost and start is None:
            start = sample.t_ns
        if start is not None and (not lost or index == len(poses) - 1):
            seconds = (sample.t_ns - start) / 1e9
            if seconds >= MIN_LOST_S:
                at_s = (start - zero_ns) / 1e9
                spans.append(Lost(at_s, seconds, _usual_reason(health, at_s, at_s + seconds)))
            start = None
    return tuple(spans)


def _usual_reason(health: HealthSeries | None, start_s: float, end_s: float) -> str:
    if health is None:
        return ""
    inside = np.flatnonzero((health.t_s >= start_s) & (health.t_s <= end_s + 1.0))
    # how long there has been no pose is known from the span
    found = Counter(
        reason
        for i in inside
        for reason in health.reasons[i]
        if not reason.startswith("no pose for")
    )
    return found.most_common(1)[0][0] if found else ""


def _health(messages: Iterable[tuple[int, dict[str, Any]]], zero_ns: int) -> HealthSeries | None:
    rows = list(messages)
    if not rows:
        return None
    disks = [message.get("disk") or {} for _, message in rows]
    return HealthSeries(
        np.array([(t_ns - zero_ns) / 1e9 for t_ns, _ in rows]),
        _numbers(message.get("celsius") for _, message in rows),
        _numbers(disk.get("free_bytes") for disk in disks) / 1e9,
        _numbers(disk.get("bytes_per_s") for disk in disks) / 1e6,
        _numbers(message.get("pose_age_ms") for _, message in rows),
        np.array([float(sum((message.get("drops") or {}).values())) for _, message in rows]),
        tuple(str(message.get("state", "")) for _, message in rows),
        tuple(tuple(map(str, message.get("reasons") or ())) for _, message in rows),
    )


def _numbers(values: Iterable[float | None]) -> Float:
    return np.array([np.nan if value is None else value for value in values], np.float64)


def _rows(recording: Recording, metadata: Mapping[str, str]) -> dict[str, str]:
    rows = {
        "recorded from": metadata.get("source", ""),
        "pace": metadata.get("pace", ""),
        "backbone": metadata.get("backbone", ""),
        "calm-edge of the recording": metadata.get("version", ""),
        "stamps": metadata.get(CLOCK_KEY, ""),
    }
    for eye in Eye:
        settings = recording.cameras(eye)
        text = ", ".join(f"{name} {value}" for name, value in settings.items() if value != "")
        rows[f"{eye.name.lower()} camera"] = text
    return {name: text for name, text in rows.items() if text}
