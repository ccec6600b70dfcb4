from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import pytest

from device.camera import CameraSpec
from device.camera_thread import CameraState, CameraThread
from device.clock import Clock, SystemClock
from device.drivers.replay import ReplayCamera
from device.drivers.v4l2 import V4l2Camera
from device.errors import CameraError
from device.frame import Eye, Frame, UnreadableImage
from tests.device.fake_video import FakeVideoIO
from tests.manual_clock import ManualClock


def frames(n: int, period_ns: int = 1_000_000, start_ns: int = 0) -> list[Frame]:
    return [Frame(Eye.PRIMARY, k, start_ns + k * period_ns, b"x") for k in range(n)]


def threaded(source: object, clock: Clock | None = None, **options: int) -> CameraThread:
    spec = CameraSpec(Eye.PRIMARY, "replay")
    camera = ReplayCamera(spec, clock or ManualClock(), frames=source)  # type: ignore[arg-type]
    return CameraThread(camera, **options)


def until(condition: Callable[[], bool]) -> None:
    limit = time.monotonic() + 5
    while not condition():
        assert time.monotonic() < limit
        time.sleep(0.001)


def test_frames_arrive_in_order_and_only_once() -> None:
    clock = SystemClock()
    thread = threaded(frames(30, start_ns=clock.now_ns()), clock)
    thread.start()
    got: list[Frame] = []
    while thread.state is CameraState.RUNNING:
        got += thread.drain()
    got += thread.drain()
    thread.stop()
    assert [f.sequence for f in got] == list(range(30))
    assert thread.state is CameraState.FINISHED and thread.error is None
    assert thread.drain() == []


def test_overflow_keeps_the_newest_and_is_counted() -> None:
    thread = threaded(frames(10), capacity=4)
    thread.start()
    until(lambda: thread.state is CameraState.FINISHED)
    assert [f.sequence for f in thread.drain()] == [6, 7, 8, 9]
    assert thread.overflow == 6


def test_an_error_sets_the_failed_state_and_keeps_queued_frames(
    caplog: pytest.LogCaptureFixture,
) -> None:
    def broken() -> Iterator[Frame]:
        yield from frames(2)
        raise UnreadableImage("primary frame 2: not a readable image")

    thread = threaded(broken())
    thread.start()
    until(lambda: thread.state is CameraState.FAILED)
    assert thread.error is not None and "not a readable image" in thread.error
    assert len(thread.drain()) == 2
    thread.stop()
    assert thread.state is CameraState.FAILED
    assert not thread.camera.connected


def test_start_raises_if_the_camera_is_missing() -> None:
    clock = ManualClock()
    spec = CameraSpec(Eye.PRIMARY, "v4l2", "usb-1")
    thread = CameraThread(V4l2Camera(spec, clock, io=FakeVideoIO(clock, {})))
    with pytest.raises(CameraError, match="usb-1"):
        thread.start()
    assert thread.state is CameraState.STOPPED


def test_stop_is_quick_and_idempotent_and_closes_the_camera() -> None:
    clock = SystemClock()
    thread = threaded(frames(3, 10**12, clock.now_ns()), clock, capacity=4)
    thread.start()
    until(lambda: len(thread.drain()) == 1)
    began = time.monotonic()
    thread.stop()
    thread.stop()
    assert time.monotonic() - began < 1
    assert thread.state is CameraState.STOPPED
    assert not thread.camera.connected


def test_a_refused_priority_is_logged_and_frames_still_come(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("device.realtime.request", lambda priority: f"{priority} not granted")
    thread = threaded(frames(5), realtime_priority=7)
    thread.start()
    until(lambda: thread.state is CameraState.FINISHED)
    assert len(thread.drain()) == 5
    assert "7 not granted" in caplog.text
