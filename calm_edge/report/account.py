"""What happened on a drive, in plain sentences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np

from calm_edge.evaluation.estimate import Estimate
from calm_edge.evaluation.results import MAX_FOCAL_SIGMA_PERCENT
from calm_edge.geometry.polyline import path_length
from calm_edge.recording.time_base import WallClock
from calm_edge.report.chart import minutes
from calm_edge.report.drive_log import DriveLog, Lost
from calm_edge.report.events import MarkedEvent, sentence

# times without a pose that are named one by one
NAMED = 3
# words of RecordResult.summary for frames that are missing, or have no pose
DROPS = {
    "camera_drops": "left out by the cameras",
    "corrupt": "corrupt",
    "unrecorded": "not recorded",
    "untracked": "recorded but not tracked in time",
}


def unit(estimate: Estimate) -> str:
    """Unit of the world: m, spacings, or `units` where a given spacing did not give metres."""
    return "m" if estimate.metric else "units" if estimate.spacing_m else "spacings"


def account(
    estimate: Estimate, log: DriveLog, loops: int, events: Sequence[MarkedEvent] = ()
) -> tuple[str, ...]:
    """Sentences on path, loops, focal lengths, metre, lost poses, frames, temperature and events.

    loops: number of loops closed. What is not known has no sentence: see `drive_report.unobserved`.
    """
    found = (
        _path(estimate, log, loops),
        _focals(estimate),
        _metre(estimate),
        _lost(log.lost),
        _frames(log),
        _heat(log),
        sentence(events),
    )
    return tuple(text for text in found if text)


def when(log: DriveLog) -> str:
    """Date of the drive in UTC, and its duration."""
    lasted = f"{minutes(log.duration_s)} min"
    if log.started_s is None:
        return f"{lasted}; without a date in its stamps" if log.duration_s else ""
    try:
        date = datetime.fromtimestamp(log.started_s, UTC).strftime("%Y-%m-%d %H:%M UTC")
    except (OverflowError, OSError, ValueError):
        return lasted
    unsure = " (the computer's clock was not set)"
    return f"{date}{unsure if log.dated_by == WallClock.UNSYNCHRONISED else ''}, {lasted}"


def _path(estimate: Estimate, log: DriveLog, loops: int) -> str:
    if len(estimate.t_ns) < 2:
        return ""
    length = path_length(estimate.T_w_c[:, :3, 3])
    seconds = log.duration_s or float(estimate.t_ns[-1] - estimate.t_ns[0]) / 1e9
    closed = {0: "no loop closed", 1: "1 loop closed"}.get(loops, f"{loops} loops closed")
    return f"{length:,.0f} {unit(estimate)} in {minutes(seconds)} min, {closed}."


def _focals(estimate: Estimate) -> str:
    sigmas = estimate.focal_sigma_percent or (None, None)
    names = ("primary", "assistant")
    known = [
        f"{sigma:.1f} % ({name})"
        for name, sigma in zip(names, sigmas, strict=True)
        if sigma is not None and sigma <= MAX_FOCAL_SIGMA_PERCENT
    ]
    return f"Focal lengths known to {' and '.join(known)}, one sigma." if known else ""


def _metre(estimate: Estimate) -> str:
    if not estimate.spacing_m or not estimate.metric:
        return ""
    given = f"The metre comes from the spacing that you gave ({estimate.spacing_m:g} m)"
    if estimate.metre is None:
        return f"{given}."
    return f"{given}; beyond its own error, lengths are known to {_percent(estimate)}, one sigma."


def _percent(estimate: Estimate) -> str:
    assert estimate.metre is not None
    return f"{100 * estimate.metre.log_sigma:.1f} %"


def _lost(lost: tuple[Lost, ...]) -> str:
    if not lost:
        return ""
    total = sum(span.seconds for span in lost)
    longest = sorted(lost, key=lambda span: -span.seconds)[:NAMED]
    parts = []
    for span in sorted(longest, key=lambda span: span.start_s):
        why = f" ({span.why})" if span.why else ""
        if span.start_s <= 0:
            parts.append(f"{span.seconds:.1f} s until the first sub-map")
        else:
            parts.append(f"{span.seconds:.1f} s at {minutes(span.start_s)}{why}")
    if len(lost) == 1:
        return f"No live pose for {parts[0]}."
    more = f", and {len(lost) - NAMED} shorter ones" if len(lost) > NAMED else ""
    return f"No live pose for {total:.1f} s in all: {', '.join(parts)}{more}."


def _frames(log: DriveLog) -> str:
    if not any(log.frames):
        return ""
    frames = f"{log.frames[0]:,} + {log.frames[1]:,} frames recorded"
    drops = losses(log.counts)
    if not log.counts:
        return f"{frames}; the recording was not ended, so that what was lost is not known."
    return f"{frames}, {', '.join(drops) if drops else 'none lost'}."


def losses(counts: Mapping[str, Any]) -> list[str]:
    """Numbers of frames that are missing or without a pose, from the counts at the end."""
    return [f"{counts[name]} {text}" for name, text in DROPS.items() if counts.get(name)]


def _heat(log: DriveLog) -> str:
    if log.health is None or not np.isfinite(log.health.celsius).any():
        return ""
    hottest = int(np.nanargmax(log.health.celsius))
    at = minutes(max(float(log.health.t_s[hottest]), 0.0))
    return f"The computer was at most {log.health.celsius[hottest]:.0f} °C, at {at}."
