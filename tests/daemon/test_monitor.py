"""State and statistics of one second, from a status of the hub and fake cameras."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from calm_edge.config import Config
from calm_edge.daemon import monitor
from calm_edge.daemon.fan_out import FanOut, Output
from calm_edge.daemon.health import Health
from calm_edge.daemon.hub_status import HubStatus
from calm_edge.daemon.ladder import Shed
from calm_edge.daemon.monitor import Monitor
from calm_edge.daemon.result import RecordResult
from calm_edge.daemon.state import Standing
from calm_edge.recording.health import WriterHealth
from device.camera import CameraStats
from device.camera_thread import CameraState
from device.frame import Eye
from device.service import NullNotifier
from tests.manual_clock import ManualClock

S = 10**9
WELL = HubStatus(
    now_ns=100 * S,
    frame_ns=(100 * S, 100 * S),
    pose_ns=100 * S,
    pose_lost=False,
    no_metre="",
    pose_age_ms=20.0,
    windows_waiting=0,
    windows_overtaken=0,
    faults=(),
    counts=RecordResult(frames=[10, 10], submaps=2, poses=1).counts(),
    drops={"images_not_recorded": 4},
    queues={"recording_fill": 0.1},
    stage_ms={"infer": 1.0},
    writer=WriterHealth("", 4, 0, 0, 0.1, 0.0),
)


class Journal(NullNotifier):
    """Notifier that keeps its lines."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def status(self, text: str, state: str = "") -> None:
        self.lines.append(text)

    def stopping(self) -> None:
        self.lines.append("stopping")


class Kept(Output):
    """Output that keeps what it receives."""

    immediate = True

    def __init__(self) -> None:
        self.calls: list[str] = []
        self.messages: list[dict[str, Any]] = []
        self.logged: list[str] = []

    def status(self, standing: Standing, health: Health | None) -> None:
        self.calls.append(standing.state.value)
        if health is not None:
            self.messages.append(health.message())

    def say(self, level: int, text: str, name: str) -> None:
        self.logged.append(text)

    def tick(self, now_ns: int) -> None:
        self.calls.append("tick")


def camera(name: str, eye: Eye) -> SimpleNamespace:
    inner = SimpleNamespace(
        spec=SimpleNamespace(name=name, eye=eye), connected=True, stats=lambda: CameraStats(drops=2)
    )
    return SimpleNamespace(
        camera=inner, state=CameraState.RUNNING, error=None, overflow=1, waiting=3
    )


class Scene:
    """A monitor with two cameras, due at every call."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        patch.setattr(monitor, "PERIOD_S", 0.0)
        self.journal, self.kept = Journal(), Kept()
        self.monitor = Monitor(Config(), self.journal, FanOut([self.kept]))
        self.cameras = [
            camera("primary camera x", Eye.PRIMARY),
            camera("assistant camera y", Eye.ASSISTANT),
        ]
        self.monitor.watch(self.cameras)  # type: ignore[arg-type]

    def update(self, status: HubStatus, ticks_late: bool = False) -> str:
        """Run one update and return the state with its first reason."""
        assert self.monitor.due()
        assert self.monitor.update(status, ticks_late, 0) == (Shed.NOTHING, "cool and caught up")
        return self.journal.lines[-1].partition(": ")[0]


@pytest.fixture
def scene(monkeypatch: pytest.MonkeyPatch) -> Scene:
    return Scene(monkeypatch)


def test_the_states_of_a_drive(scene: Scene) -> None:
    assert scene.journal.lines == ["STARTING"]
    nothing = RecordResult(frames=[10, 10])
    assert scene.update(replace(WELL, counts=nothing.counts())) == "STARTING (no sub-map yet"
    nothing.submaps = 1
    unposed = replace(WELL, counts=nothing.counts())
    assert scene.update(unposed) == "STARTING (waiting for the first pose)"
    # a first pose that is not metric ends the start
    first = RecordResult(frames=[10, 10], submaps=1, unscaled_poses=1)
    counts = first.counts()
    assert scene.update(replace(WELL, counts=counts, no_metre="no metre")) == "DEGRADED (no metre)"
    assert scene.update(WELL) == "RUNNING"
    unscaled = replace(WELL, no_metre="no metre: the car stood still")
    assert scene.update(unscaled) == "DEGRADED (no metre"
    assert scene.kept.messages[-1]["reasons"] == ["no metre: the car stood still"]
    assert scene.update(replace(WELL, pose_ns=98 * S)) == "LOST (no pose for 2 s)"
    assert scene.update(replace(WELL, pose_lost=True)) == "LOST (no pose for 0 s)"
    assert scene.update(replace(WELL, windows_waiting=3)) == "LAGGING (3 windows wait to be solved)"
    assert scene.update(WELL, ticks_late=True) == "LAGGING (capture loop is late)"
    scene.monitor.stop(100 * S)
    assert scene.journal.lines[-2:] == ["stopping", "STOPPING"]
    # a tick follows, so that outputs act on the end at once and not only after the last window
    assert scene.kept.calls == [
        "STARTING", "STARTING", "DEGRADED", "RUNNING", "DEGRADED", "LOST", "LOST",
        "LAGGING", "LAGGING", "STOPPING", "tick",
    ]  # fmt: skip
    assert [text.split()[0].rstrip(":") for text in scene.kept.logged] == [
        "DEGRADED", "RUNNING", "DEGRADED", "LOST", "LAGGING", "STOPPING"
    ]  # fmt: skip


def test_faults_are_named_as_reasons(scene: Scene) -> None:
    assert scene.update(replace(WELL, frame_ns=(100 * S, 99 * S))) == "DEGRADED (assistant camera y"
    assert "assistant camera y: no frame for 1.0 s" in scene.journal.lines[-1]
    scene.cameras[1].camera.connected = False
    scene.update(WELL)
    assert "assistant camera y: disconnected, waiting for it" in scene.journal.lines[-1]
    scene.cameras[1].state = CameraState.FAILED
    scene.cameras[1].error = "assistant camera y: burnt"
    scene.update(replace(WELL, faults=("rec: disk full", "estimator failed")))
    second = scene.kept.messages[-1]
    assert second["reasons"] == [
        "assistant camera y: burnt", "rec: disk full", "estimator failed"
    ]  # fmt: skip


def test_counts_of_cameras_and_hub_are_combined(scene: Scene) -> None:
    scene.update(WELL)
    second = scene.kept.messages[-1]
    assert second["drops"] == {
        "missed_by_the_cameras": 4,
        "stamps_moved": 0,
        "corrupt": 0,
        "overflowed": 2,
        "images_not_recorded": 4,
    }
    assert second["queues"] == {"primary_frames": 3, "assistant_frames": 3, "recording_fill": 0.1}
    assert second["stage_ms"]["infer"] == 1.0 and "loop_frames" in second["stage_ms"]
    assert second["counts"]["submaps"] == 2 and second["pose_age_ms"] == 20.0


def test_a_finished_replay_is_not_a_fault(scene: Scene) -> None:
    scene.cameras[1].state = CameraState.FINISHED
    assert scene.update(replace(WELL, frame_ns=(100 * S, 50 * S))) == "RUNNING"


def test_a_backlog_reduces_work_and_is_a_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = ManualClock()
    monkeypatch.setattr(monitor.time, "monotonic", lambda: clock.now_ns() / S)
    scene = Scene(monkeypatch)
    decisions = []
    for _ in range(3):
        clock.advance(30 * S)
        assert scene.monitor.due()
        decisions.append(scene.monitor.update(replace(WELL, windows_waiting=9), False, 0))
    half = (Shed.HALF_THE_WINDOWS, "9 windows wait to be solved")
    assert decisions == [(Shed.NOTHING, "9 windows wait to be solved"), half, half]
    last = scene.kept.messages[-1]
    assert f"{last['shed']}: 9 windows wait to be solved" in last["reasons"]
    assert last["shed"] == Shed.HALF_THE_WINDOWS.words
