"""Fault rows with wrong clocks and stamps, and with an overheated computer."""

from __future__ import annotations

import dataclasses
import itertools
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from calm_edge.config import merge
from calm_edge.daemon.hub import Hub
from calm_edge.daemon.ladder import Shed
from calm_edge.daemon.source import Source, of_sequence
from calm_edge.recording import schema
from calm_edge.recording.reader import Recording
from device.camera import Camera, CameraStats
from device.clock import Clock
from device.frame import Eye, Frame
from device.stream import Stream
from tests.faults.row import AfterFrames, Row, all_frames, health, states
from tests.replay.daemon_run import config_for, record

HOUR_NS = 3600 * 10**9


def wall_clock(drive: Path, n: int, folder: Path) -> Row:
    """Set the wall clock back by two hours in the middle of the drive."""
    real, offset_ns = time.time_ns, [0]

    def set_back(_: Hub) -> None:
        offset_ns[0] = -2 * HOUR_NS

    with mock.patch("time.time_ns", lambda: real() + offset_ns[0]):
        during = AfterFrames((n // 2, set_back))
        record(drive, folder / "rec", lockstep=False, during=during)
    recording = Recording(folder / "rec")
    pairs = list(recording.json_messages(schema.CLOCK))
    wall = np.array([p["realtime_ns"] - p["monotonic_ns"] for p in pairs])
    steps_h = np.diff(wall) / HOUR_NS
    stamps = [recording.frame_times(eye) for eye in Eye]
    gaps_ms = np.concatenate([np.diff(t) for t in stamps]) / 1e6
    return Row(
        "wall clock -2 h",
        f"{len(pairs)} clock readings show {steps_h.min():+.2f} h; frames "
        f"{gaps_ms.min():.1f} to {gaps_ms.max():.1f} ms apart",
        "no stamp changes; the step is in the clock readings",
        all_frames(folder / "rec", n)
        and abs(steps_h.min() + 2) < 0.01
        and bool(np.allclose(gaps_ms, 100.0, atol=0.01)),
    )


class WrongStamps:
    """A camera whose driver gives wrong stamps, or none; kind: as in `wrong_stamps`."""

    def __init__(self, inner: Camera, clock: Clock, kind: str) -> None:
        self.spec, self._inner, self._clock, self._kind = inner.spec, inner, clock, kind
        self._stream = Stream()
        self._index = itertools.count()

    def start(self) -> None:
        self._inner.start()

    def read(self, timeout_s: float) -> Frame | None:
        frame = self._inner.read(timeout_s)
        if frame is None:
            return None
        now_ns, index = self._clock.now_ns(), next(self._index)
        t_ns = frame.t_ns
        if self._kind == "without a clock":
            self._stream.count("host_stamped")
            t_ns = now_ns
        elif index % 7 == 3:
            t_ns += 178_000_000 if self._kind == "from the future" else -350_000_000
        return self._stream.admit(dataclasses.replace(frame, t_ns=t_ns), now_ns)

    def latest(self, max_age_ns: int) -> Frame | None:
        return self.read(0.0)

    def stop(self) -> None:
        self._inner.stop()

    def stats(self) -> CameraStats:
        return self._stream.stats

    @property
    def settings(self) -> Mapping[str, int | float | str]:
        return self._inner.settings

    @property
    def remarks(self) -> Sequence[str]:
        return self._inner.remarks

    @property
    def connected(self) -> bool:
        return self._inner.connected

    @property
    def exhausted(self) -> bool:
        return self._inner.exhausted


def wrong_stamps(drive: Path, n: int, folder: Path, kind: str) -> Row:
    """Record with wrong stamps. kind: `from the future`, `backwards` or `without a clock`."""
    config = config_for(drive)
    source = of_sequence(drive, True)

    def cameras() -> tuple[Camera, Camera]:
        primary, assistant = source.open()
        clock = source.clock
        return WrongStamps(primary, clock, kind), WrongStamps(assistant, clock, kind)

    wrongly_stamped = Source(cameras, source.clock, True, source.description)
    result, _ = record(drive, folder / "rec", lockstep=False, config=config, source=wrongly_stamped)
    recording = Recording(folder / "rec")
    stamps = [recording.frame_times(eye) for eye in Eye]
    increasing = all(bool((np.diff(t) > 0).all()) for t in stamps)
    wrong = 0 if kind == "without a clock" else 2 * len(range(3, n, 7))
    last = max(int(t[-1]) for t in stamps)
    drive_end_ns = 10**9 + (n - 1) * 10**8 + 17 * 10**6
    return Row(
        f"stamps {kind}",
        f"{result.clamped_stamps} of {wrong} wrong stamps clamped, {sum(result.frames)} of "
        f"{2 * n} frames recorded, stamps increasing",
        "every frame recorded, stamps increase, never in the future, wrong ones counted",
        all_frames(folder / "rec", n)
        and increasing
        and (result.clamped_stamps >= wrong if wrong else result.clamped_stamps == 0)
        and last < drive_end_ns + 10**9,
    )


def heat(root: Path, celsius: float, throttled: bool) -> None:
    """Write a thermal tree as in the kernel's sysfs."""
    for name, files in {
        "thermal_zone0": {"type": "cpu-thermal", "temp": f"{celsius * 1000:.0f}"},
        "cooling_device0": {"type": "Processor", "cur_state": str(int(throttled))},
    }.items():
        (root / name).mkdir(parents=True, exist_ok=True)
        for file, text in files.items():
            (root / name / file).write_text(text)


def _degraded(message: dict[str, Any]) -> bool:
    """Whether a message on /health that reports work left out says so in its state.

    DEGRADED, or what comes before it: STARTING until the first sub-map, which a slow computer makes
    after the heat, or LOST.
    """
    shed = message["shed"]
    if shed == Shed.NOTHING.words:
        return True
    named = any(reason.startswith(shed) for reason in message["reasons"])
    return named and message["state"] in ("STARTING", "LOST", "DEGRADED")


def throttling(drive: Path, n: int, folder: Path) -> Row:
    """Run hot until all that can be left out is left out, then cool.

    Windows are long, so that few wait for the estimator: what is judged is the heat, and a queue
    would put off the end of the shedding for as long as the estimator takes to start.
    """
    tree = folder / "thermal"
    heat(tree, 92.0, True)
    step_s = n / 160
    degrade = {"thermal_root": str(tree), "step_s": step_s}
    changes = {"degrade": degrade, "recording": {"log_depth": True}}
    config = merge(config_for(drive, n_max=12), changes)

    def during(hub: Hub, _: str) -> None:
        if hub._shed is Shed.ALL_WINDOWS:
            heat(tree, 50.0, False)

    # updates are a second apart on a drive of half a minute, and closer on a shorter one
    with mock.patch("calm_edge.daemon.monitor.PERIOD_S", min(1.0, step_s / 2)):
        result, lines = record(drive, folder / "rec", lockstep=False, config=config, during=during)
    met = [m["shed"] for m in health(folder / "rec")]
    steps = [text for text, _ in itertools.groupby(met)]
    order = [shed.words for shed in Shed]
    down = [order.index(s) for s in steps[: steps.index(order[-1]) + 1]] if order[-1] in met else []
    up = [order.index(s) for s in steps[len(down) :]]
    return Row(
        "throttling, 92 °C",
        f"{' > '.join(steps)}; {2 * n} of {sum(result.frames)} frames; "
        f"{' '.join(states(folder / 'rec'))}",
        "depth, then keyframes, then windows left out; resumed when cool; no frame lost",
        all_frames(folder / "rec", n)
        and down == sorted(down)
        and len(down) >= 3
        and up == sorted(up, reverse=True)
        and len(up) >= 1
        and any("92 °C, processor throttled" in line for line in lines)
        and all(_degraded(message) for message in health(folder / "rec")),
    )
