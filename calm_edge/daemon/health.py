"""Status of the daemon, once a second: as JSON message and as line of text."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from calm_edge.daemon.state import Standing
from calm_edge.daemon.tick_latency import TickLatency
from calm_edge.recording.health import WriterHealth
from device.thermal import Thermal


@dataclass(frozen=True, slots=True)
class Health:
    """Status of one second.

    shed: work that is left out to reduce the load, as text. tick: latency of the capture loop.
    late_ticks, counts, drops: since the start: deadlines missed by the capture loop, numbers of
    items, and losses by cause. queues: lengths by name. stage_ms: durations of the stages of the
    newest window and of the capture loop. pose_age_ms: largest age of a pose in this second,
    exposure to publishing.
    """

    standing: Standing
    shed: str
    tick: TickLatency
    late_ticks: int
    counts: dict[str, int]
    drops: dict[str, int]
    queues: dict[str, float]
    stage_ms: dict[str, float]
    pose_age_ms: float | None
    writer: WriterHealth
    thermal: Thermal

    def message(self) -> dict[str, Any]:
        """JSON object for the topic /health of the recording."""
        return {
            "state": self.standing.state.value,
            "reasons": list(self.standing.reasons),
            "shed": self.shed,
            "tick": _rounded(dataclasses.asdict(self.tick)),
            "late_ticks": self.late_ticks,
            "counts": self.counts,
            "drops": self.drops,
            "queues": _rounded(self.queues),
            "stage_ms": _rounded(self.stage_ms),
            "pose_age_ms": self.pose_age_ms and round(self.pose_age_ms, 1),
            "disk": {
                "error": self.writer.error,
                "free_bytes": self.writer.space.free_bytes,
                "floor_bytes": self.writer.space.floor_bytes,
                "bytes_per_s": round(self.writer.space.bytes_per_s),
                "left_s": self.writer.space.left_s,
                "sync_ms": round(self.writer.sync_ms, 1),
                "kept": self.writer.kept,
            },
            "celsius": self.thermal.celsius,
            "throttled": self.thermal.throttled,
        }

    def line(self) -> str:
        """One line of text for the user."""
        frames = f"{self.counts['primary_frames']}+{self.counts['assistant_frames']} frames"
        lost = {cause: n for cause, n in self.drops.items() if n}
        losses = ", ".join(f"{n} {cause.replace('_', ' ')}" for cause, n in lost.items())
        parts = [
            f"{frames}, {losses or 'none lost'}",
            f"{self.counts['submaps']} of {self.counts['windows']} sub-maps",
        ]
        if self.pose_age_ms is not None:
            parts.append(f"pose {self.pose_age_ms:.0f} ms old")
        if self.thermal.celsius is not None:
            parts.append(f"{self.thermal.celsius:.0f} °C")
        parts.append(time_left(self.writer))
        return f"{self.standing}: {', '.join(filter(None, parts))}"


def time_left(writer: WriterHealth) -> str:
    """Recording time left on the disk, e.g. `3 h 05 min left`; empty if unknown."""
    left_s = writer.space.left_s
    if writer.error or left_s is None:
        return ""
    hours, minutes = divmod(int(left_s // 60), 60)
    room = f"{hours} h {minutes:02} min left" if hours < 1000 else "weeks left"
    return f"{room}, then the oldest drives are removed" if writer.space.removes_old else room


def _rounded(values: dict[str, Any]) -> dict[str, Any]:
    return {k: round(v, 3) if isinstance(v, float) else v for k, v in values.items()}
