"""What a second of the daemon comes to, with everything around it played."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from calm_edge.config import Config
from calm_edge.daemon import monitor
from calm_edge.daemon.ladder import Shed
from calm_edge.daemon.monitor import Monitor
from calm_edge.daemon.result import RecordResult
from calm_edge.recording.health import WriterHealth
from device.camera import CameraStats
from device.camera_thread import CameraState
from device.clock import ManualClock
from device.frame import Eye

S = 10**9


class Heard:
    """What was told, by whom: status lines, messages, log lines, states on the serial line."""

    watchdog_s = None

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.messages: list[dict[str, Any]] = []
        self.logged: list[str] = []
        self.states: list[str] = []
        self.told: list[str] = []
        self.described: list[dict[str, str]] = []
        self.health = WriterHealth("", 0, 0, 0, 0, 0.0, 0.0)

    def status(self, text: str, state: str = "") -> None:
        self.lines.append(text)

    def stopping(self) -> None:
        self.lines.append("stopping")

    def write_status(self, message: dict[str, Any], topic: str) -> None:
        assert topic == "/health"
        self.messages.append(message)

    def write_log(self, level: int, text: str, name: str) -> None:
        self.logged.append(text)

    def write_metadata(self, name: str, values: dict[str, str]) -> None:
        assert name == "calm_edge.cameras"
        self.described.append(values)

    def publish(self, sample: None, now_ns: int) -> None:
        self.told.append(self.states[-1])

    def report(self, state: str, reasons: tuple[str, ...]) -> None:
        self.states.append(state)


def camera(name: str, eye: Eye) -> SimpleNamespace:
    inner = SimpleNamespace(
        spec=SimpleNamespace(name=name, eye=eye),
        connected=True,
        stats=lambda: CameraStats(drops=2),
        settings={"gain": "auto"},
        remarks=(),
    )
    return SimpleNamespace(
        camera=inner, state=CameraState.RUNNING, error=None, overflow=1, waiting=0
    )


class Scene:
    """A daemon in its second second, all well."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        patch.setattr(monitor, "PERIOD_S", 0.0)
        self.clock, self.heard = ManualClock(100 * S), Heard()
        self.result = RecordResult(frames=[10, 10])
        self.left_out: list[Shed] = []
        self.said: list[str] = []
        self.estimator = SimpleNamespace(
            waiting=0, given_up=False, overtaken=0, left_to_map=[], lost=[], unsolved=[]
        )
        self.desk = SimpleNamespace(
            config=Config(),
            result=self.result,
            source=SimpleNamespace(clock=self.clock),
            recording=self.heard,
            publisher=self.heard,
            estimator=self.estimator,
            tracker=SimpleNamespace(given_up=False, in_flight=0, attaching=0, frames_lost=0),
            stage_ms={"infer": 1.0},
            shed=Shed.NOTHING,
            live_ns=100 * S,
            frame_ns=[100 * S, 100 * S],
            say=self.said.append,
        )
        self.monitor = Monitor(self.desk, self.heard)  # type: ignore[arg-type]
        self.cameras = [
            camera("primary camera x", Eye.PRIMARY),
            camera("assistant camera y", Eye.ASSISTANT),
        ]
        self.monitor.watch(self.cameras)  # type: ignore[arg-type]

    def look(self, ticks_late: bool = False) -> str:
        self.monitor.look(ticks_late, 0)
        return self.heard.lines[-1].partition(": ")[0] if self.heard.lines else ""

    def pose(self) -> None:
        self.result.note_pose(False, 20.0)
        self.desk.live_ns = self.clock.now_ns()


@pytest.fixture
def scene(monkeypatch: pytest.MonkeyPatch) -> Scene:
    return Scene(monkeypatch)


def test_a_drive_from_its_start_to_its_end(scene: Scene) -> None:
    assert scene.heard.lines == ["STARTING"]
    assert scene.look() == "STARTING (no sub-map yet"
    scene.pose()
    assert scene.look() == "RUNNING"
    scene.clock.advance(2 * S)
    scene.desk.frame_ns = [102 * S, 102 * S]
    assert scene.look() == "LOST (no pose for 2 s)"
    scene.pose()
    scene.estimator.waiting = 3
    assert scene.look() == "LAGGING (3 windows wait)"
    scene.estimator.waiting = 0
    assert scene.look(ticks_late=True) == "LAGGING (ticks come late)"
    scene.monitor.stop()
    assert scene.heard.lines[-2:] == ["stopping", "STOPPING"]
    assert scene.heard.states == [
        "STARTING", "RUNNING", "LOST", "LAGGING", "LAGGING", "STOPPING"
    ]  # fmt: skip
    assert [text.split()[0].rstrip(":") for text in scene.heard.logged] == [
        "RUNNING", "LOST", "LAGGING", "STOPPING"
    ]  # fmt: skip
    # what follows may be a long window: the line hears of the end at once
    assert scene.heard.told == ["STOPPING"]


def test_the_cameras_settings_are_noted_at_once_and_when_they_change(scene: Scene) -> None:
    auto = '{"gain": "auto"}'
    assert scene.heard.described == [{"primary": auto, "assistant": auto, "since_ns": str(100 * S)}]
    scene.look()
    assert len(scene.heard.described) == 1
    scene.clock.advance(S)
    scene.cameras[0].camera.settings = {"gain": 7}
    # a camera that is gone has no settings
    scene.cameras[1].camera.settings = {}
    scene.look()
    assert scene.heard.described[1:] == [
        {"primary": '{"gain": 7}', "assistant": auto, "since_ns": str(101 * S)}
    ]


def test_what_a_camera_does_not_do_as_asked_is_said_once(scene: Scene) -> None:
    scene.cameras[1].camera.remarks = ("assistant camera y: has no gain control; not set",)
    scene.look()
    scene.look()
    assert scene.said == ["assistant camera y: has no gain control; not set"]


def test_what_is_missing_is_named(scene: Scene) -> None:
    scene.pose()
    scene.desk.frame_ns = [100 * S, 99 * S]
    assert scene.look() == "DEGRADED (assistant camera y"
    assert "assistant camera y: no frame for 1.0 s" in scene.heard.lines[-1]
    scene.desk.frame_ns = [100 * S, 100 * S]
    scene.cameras[1].camera.connected = False
    scene.look()
    assert "assistant camera y: gone, looked for again" in scene.heard.lines[-1]
    scene.cameras[1].state = CameraState.FAILED
    scene.cameras[1].error = "assistant camera y: burnt"
    scene.heard.health = WriterHealth("rec: disk full", 0, 4, 0, 0, 0.0, 0.0)
    scene.estimator.given_up = True
    scene.look()
    reasons = scene.heard.messages[-1]["reasons"]
    assert reasons == ["assistant camera y: burnt", "rec: disk full", "estimator given up"]
    drops = scene.heard.messages[-1]["drops"]
    assert drops["images_not_recorded"] == 4
    assert drops["missed_by_the_cameras"] == 4 and drops["overflowed"] == 2


def test_a_finished_replay_is_no_fault(scene: Scene) -> None:
    scene.pose()
    scene.desk.frame_ns = [100 * S, 50 * S]
    scene.cameras[1].state = CameraState.FINISHED
    assert scene.look() == "RUNNING"
