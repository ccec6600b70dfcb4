"""Fault row with a failing and a slow output beside the recording."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from calm_edge.daemon.fan_out import Output
from calm_edge.daemon.health import Health
from calm_edge.daemon.messages import Attached
from calm_edge.daemon.result import RecordResult
from calm_edge.daemon.state import Standing
from calm_edge.recording import schema
from calm_edge.recording.reader import Recording
from calm_edge.recording.window_record import WindowRecord
from calm_edge.types import Float32, LocalizerUpdate, PoseSample
from device.frame import Frame
from tests.faults.row import Row, all_frames, health, loop_figures
from tests.replay.daemon_run import record


class Counting(Output):
    """Counts the messages it receives, by kind."""

    name, immediate = "counting", True

    def __init__(self) -> None:
        self.given: Counter[str] = Counter()

    def take(self, kind: str) -> None:
        self.given[kind] += 1

    def frame(self, frame: Frame) -> None:
        self.take("frame")

    def window(self, window: WindowRecord) -> None:
        self.take("window")

    def pose(self, sample: PoseSample, now_ns: int) -> None:
        self.take("pose")

    def moves(self, t_ns: int, moves: Float32) -> None:
        self.take("moves")

    def update(self, update: LocalizerUpdate) -> None:
        self.take("update")

    def attached(self, attached: Attached) -> None:
        self.take("attached")

    def cameras(self, settings: Mapping[str, str]) -> None:
        self.take("cameras")

    def status(self, standing: Standing, health: Health | None) -> None:
        self.take("status")

    def say(self, level: int, text: str, name: str) -> None:
        self.take("say")

    def close(self, result: RecordResult) -> None:
        self.take("close")


class Failing(Counting):
    """Raises on every message."""

    name = "failing"

    def take(self, kind: str) -> None:
        super().take(kind)
        raise OSError(f"no {kind} today")


class Slow(Counting):
    """Takes 50 ms for every message, with a queue of little more than one frame."""

    name, immediate, queue_bytes = "slow", False, 20_000

    def take(self, kind: str) -> None:
        time.sleep(0.05)
        super().take(kind)


def bad_outputs(drive: Path, n: int, folder: Path, *, lockstep: bool = False) -> Row:
    """Record with a failing, a slow and a working output."""
    failing, slow, counting = Failing(), Slow(), Counting()
    outputs = [failing, slow, counting]
    result, _ = record(drive, folder / "rec", lockstep=lockstep, outputs=outputs)
    recording = Recording(folder / "rec")
    poses = recording.count(schema.POSE_SAMPLE)
    total = counting.given.total()
    lost = result.output_losses
    summary: dict[str, Any] = list(recording.json_messages(schema.STATUS))[-1]
    complete = (
        result.frames == [n, n]
        and result.unrecorded == 0
        and all_frames(folder / "rec", n)
        and counting.given["frame"] == 2 * n
        and poses == result.poses + result.lost_poses == counting.given["pose"] > 0
        and recording.count(schema.WINDOW) == counting.given["window"] > 0
        and recording.count(schema.SUBMAP) == counting.given["update"] > 0
    )
    counted = (
        failing.given == counting.given
        and lost["failing"] == total
        and slow.given.total() + lost["slow"] == total
        and 0 < lost["slow"] < total
        and lost["counting"] == 0
        and summary["output_losses"] == lost
    )
    if not lockstep:
        drops = health(folder / "rec")[-1]["drops"]
        counted &= 0 < drops["failing_messages"] <= total and drops["slow_messages"] > 0
    return Row(
        "an output fails, another is slow",
        f"{lost['failing']} and {lost['slow']} of {total} messages lost to them, "
        f"{sum(result.frames)} frames and {poses} poses recorded"
        + ("" if lockstep else f", {loop_figures(folder / 'rec')}"),
        "nothing else lost; each loss counted",
        complete and counted,
    )
