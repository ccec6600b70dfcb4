from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from datetime import timedelta
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from device.camera import CameraControls, CameraSpec
from device.clock import SystemClock
from device.drivers import oak
from device.drivers.oak import DevicePipeline, OakCamera, parse
from device.drivers.oak_pipeline import Queue, SocketRequest
from device.errors import CameraError
from device.frame import Eye
from tests.device.fake_oak import FakeOak, encoded
from tests.device.fake_video import JPEG
from tests.manual_clock import ManualClock

S = 1_000_000_000
MS = 1_000_000


class Bench:
    """Both cameras on sockets of one fake device; the clock starts at 10 s."""

    def __init__(self, **controls: int | str) -> None:
        self.clock = ManualClock(10 * S)
        self.oak = FakeOak(self.clock)
        wanted = CameraControls(**controls)  # type: ignore[arg-type]
        self.primary, self.assistant = (
            OakCamera(
                CameraSpec(eye, "oak", f"OAK1/{socket}", controls=wanted),
                self.clock,
                factory=self.oak.factory,
            )
            for eye, socket in ((Eye.PRIMARY, "CAM_B"), (Eye.ASSISTANT, "CAM_C"))
        )

    def start(self) -> None:
        self.primary.start()
        self.assistant.start()

    def film(self, socket: str, sequence: int, t_ns: int, data: bytes | None = None) -> Any:
        message = encoded(sequence, t_ns, JPEG % sequence if data is None else data)
        self.oak.film(socket, t_ns, message)
        return message


@pytest.mark.parametrize(
    ("address", "eye", "parsed"),
    [
        ("", Eye.PRIMARY, ("", "CAM_B", False)),
        ("", Eye.ASSISTANT, ("", "CAM_C", False)),
        ("14442C", Eye.ASSISTANT, ("14442C", "CAM_A", False)),
        ("14442C/CAM_B", Eye.PRIMARY, ("14442C", "CAM_B", False)),
        ("14442C/CAM_B/raw", Eye.PRIMARY, ("14442C", "CAM_B", True)),
        ("14442C/raw", Eye.PRIMARY, ("14442C", "CAM_A", True)),
        ("/CAM_D", Eye.PRIMARY, ("", "CAM_D", False)),
    ],
)
def test_addresses(address: str, eye: Eye, parsed: tuple[str, str, bool]) -> None:
    assert parse(CameraSpec(eye, "oak", address)) == parsed


@pytest.mark.parametrize("address", ["X/left", "X/CAM_Z", "X/CAM_A/CAM_B", "X/CAM_A/row", "X/"])
def test_the_error_for_a_wrong_address_gives_the_syntax(address: str) -> None:
    with pytest.raises(CameraError, match=r"oak:.*: expected oak:ID/CAM_A"):
        parse(CameraSpec(Eye.PRIMARY, "oak", address))


def test_two_sockets_of_one_device_share_one_pipeline() -> None:
    bench = Bench()
    bench.start()
    assert len(bench.oak.built) == 1
    assert [w.socket for w in bench.oak.built[0][1]] == ["CAM_B", "CAM_C"]
    bench.film("CAM_B", 7, 10 * S)
    bench.film("CAM_C", 9, 10 * S)
    first, second = bench.primary.read(0.1), bench.assistant.read(0.1)
    assert first is not None and (first.eye, first.sequence) == (Eye.PRIMARY, 7)
    assert second is not None and (second.eye, second.image) == (Eye.ASSISTANT, JPEG % 9)
    bench.primary.stop()
    assert bench.oak.pipeline.alive()
    bench.assistant.stop()
    assert bench.oak.pipeline.closed


def test_each_device_has_its_own_pipeline() -> None:
    clock = ManualClock(10 * S)
    oaks = FakeOak(clock, "A"), FakeOak(clock, "B")
    factories = {"A": oaks[0].factory, "B": oaks[1].factory}

    def factory(device: str, wanted: Sequence[SocketRequest]) -> Any:
        return factories[device](device, wanted)

    cameras = [
        OakCamera(CameraSpec(eye, "oak", device), clock, factory=factory)
        for eye, device in ((Eye.PRIMARY, "A"), (Eye.ASSISTANT, "B"))
    ]
    for camera in cameras:
        camera.start()
    assert [len(o.built) for o in oaks] == [1, 1]
    oaks[0].pipeline.dead = True
    assert cameras[0].read(0.5) is None and not cameras[0].connected
    assert cameras[1].read(0.5) is None and cameras[1].connected


@pytest.mark.parametrize("how", ["queue closed", "pipeline dead"])
def test_a_lost_device_is_reopened_and_both_cameras_reconnect(how: str) -> None:
    bench = Bench()
    bench.start()
    for socket in ("CAM_B", "CAM_C"):
        bench.film(socket, 5, 10 * S)
    assert bench.primary.read(0.1) and bench.assistant.read(0.1)
    if how == "queue closed":
        bench.oak.pipeline.close()
    else:
        bench.oak.pipeline.dead = True
    bench.oak.present = False
    assert bench.primary.read(0.5) is None and bench.assistant.read(0.5) is None
    assert not bench.primary.connected and not bench.assistant.connected
    bench.oak.present = True
    # the device restarts its frame counter
    for k in range(2):
        for socket in ("CAM_B", "CAM_C"):
            bench.film(socket, k, 12 * S + 500 * MS + k * 100 * MS)
    frames = [c.read(5.0) for c in (bench.primary, bench.assistant) for _ in range(2)]
    assert [f and f.sequence for f in frames] == [6, 7, 6, 7]
    assert len(bench.oak.built) == 2
    for camera in (bench.primary, bench.assistant):
        assert (camera.stats().reconnects, camera.stats().drops) == (1, 0)


def test_a_silent_device_is_reopened() -> None:
    bench = Bench()
    bench.start()
    assert bench.primary.read(5.0) is None
    assert len(bench.oak.built) >= 2 and bench.oak.built[0][0].closed


def test_frames_of_an_unsynchronised_device_are_stamped_by_the_host() -> None:
    bench = Bench()
    bench.clock.advance(3600 * S)
    bench.start()
    message = bench.film("CAM_B", 0, 3610 * S)
    message.setTimestamp(timedelta(seconds=4))
    frame = bench.primary.read(0.1)
    assert frame is not None and frame.t_ns == 3610 * S
    assert bench.primary.stats().host_stamped == 1


def test_data_that_is_not_jpeg_counts_as_corrupt() -> None:
    bench = Bench()
    bench.start()
    bench.film("CAM_B", 0, 10 * S, data=b"nothing")
    assert bench.primary.read(0.1) is None
    assert bench.primary.stats().corrupt == 1


def test_raw_images_of_every_type_become_bgr() -> None:
    dai = oak.load()
    gray = np.full((48, 64), 90, np.uint8)
    for pixels, kind in (
        (cv2.cvtColor(gray, cv2.COLOR_GRAY2BGR), dai.ImgFrame.Type.NV12),
        (cv2.cvtColor(gray, cv2.COLOR_GRAY2BGR), dai.ImgFrame.Type.BGR888i),
        (gray, dai.ImgFrame.Type.GRAY8),
    ):
        message = dai.ImgFrame()
        message.setCvFrame(pixels, kind)
        image = oak.image_of(message)
        assert isinstance(image, np.ndarray) and image.shape == (48, 64, 3)
        assert np.abs(image.astype(int) - 90).max() <= 2


def test_exposure_is_not_locked_if_frames_do_not_report_it() -> None:
    bench = Bench(exposure_us="auto-then-lock", focus="lock")
    bench.start()
    for k in range(25):
        message = bench.film("CAM_B", k, 10 * S + k * 100 * MS)
        bench.film("CAM_C", k, 10 * S + k * 100 * MS)
    for _ in range(25):
        assert bench.primary.read(1.0) is not None
    assert message.getSensitivity() == 0
    assert not [c for _, c in bench.oak.pipeline.sent if isinstance(c.exposure_us, int)]


def test_locked_values_are_kept_when_the_pipeline_is_rebuilt(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    values = {"exposure_us": 8000, "gain": 200, "white_balance_k": 5000, "focus": 120}
    monkeypatch.setattr(oak, "control_values", lambda message: values)
    bench = Bench(exposure_us="auto-then-lock", focus="auto-then-lock")
    bench.start()
    for k in range(25):
        bench.film("CAM_B", k, 10 * S + k * 100 * MS)
    for _ in range(25):
        assert bench.primary.read(1.0) is not None
    ((socket, held),) = bench.oak.pipeline.sent
    assert socket == "CAM_B"
    assert held == CameraControls(8000, 200, "auto", 120)
    assert bench.primary.settings["exposure_us"] == 8000
    bench.oak.pipeline.dead = True
    bench.primary.read(0.5)
    bench.primary.read(2.0)
    assert len(bench.oak.built) == 2
    assert bench.oak.built[-1][1][0].controls == held


def test_exposure_without_gain_raises() -> None:
    with pytest.raises(CameraError, match="give both as numbers"):
        Bench(exposure_us=8000)


class Recorded:
    """Records calls to a pipeline node; fails on attributes that depthai's own node lacks."""

    def __init__(self, real: Any, calls: list[tuple[Any, ...]]) -> None:
        self._real, self._calls = real, calls
        self.initialControl = oak.load().CameraControl()
        self.queue = object()

    def __getattr__(self, name: str) -> Any:
        assert name in ("inputControl", "out") or hasattr(self._real, name), name
        assert hasattr(self._real, name), f"{self._real} has no {name}"
        if name in ("inputControl", "out"):
            return self

        def call(*args: Any, **kwargs: Any) -> Any:
            self._calls.append((self._real.__name__, name, args, kwargs))
            return self

        return call

    def createOutputQueue(self, *, maxSize: int, blocking: bool) -> Any:
        self._calls.append(("Output", "createOutputQueue", (maxSize, blocking), {}))
        return self.queue

    def createInputQueue(self) -> Any:
        return self.queue


class RecordedPipeline:
    def __init__(self) -> None:
        self.calls: list[tuple[Any, ...]] = []
        self.started = False

    def create(self, node: Any) -> Recorded:
        return Recorded(node, self.calls)

    def start(self) -> None:
        self.started = True


class RecordedDevice:
    def getDeviceId(self) -> str:
        return "14442C"


def test_device_pipeline_matches_the_api_of_depthai() -> None:
    dai, pipeline = oak.load(), RecordedPipeline()
    held = CameraControls(8000, 200, 5000, 120)
    wanted = [
        SocketRequest("CAM_B", 1280, 720, 10.0, False, held),
        SocketRequest("CAM_C", 640, 480, 10.0, True, CameraControls()),
    ]
    built = DevicePipeline(dai, RecordedDevice(), pipeline, wanted)
    assert pipeline.started and set(built.queues) == {"CAM_B", "CAM_C"}
    made = [(node, call) for node, call, _, _ in pipeline.calls]
    assert made == [
        ("Camera", "build"),
        ("Camera", "requestOutput"),
        ("VideoEncoder", "build"),
        ("Output", "createOutputQueue"),
        ("Camera", "build"),
        ("Camera", "requestOutput"),
        ("Output", "createOutputQueue"),
    ]
    assert pipeline.calls[0][2] == (dai.CameraBoardSocket.CAM_B,)
    assert pipeline.calls[2][3]["profile"] == dai.VideoEncoderProperties.Profile.MJPEG
    # a blocking queue would stall the device whenever the host is late
    assert pipeline.calls[3][2] == (8, False)


class HostNode:
    """A depthai pipeline that runs on the host, with depthai's own queues and clock."""

    device = "host"

    def __init__(self, pipeline: Any, queue: Queue) -> None:
        self._pipeline = pipeline
        self.queues = {"CAM_B": queue}
        pipeline.start()

    def alive(self) -> bool:
        return bool(self._pipeline.isRunning())

    def control(self, socket: str, controls: CameraControls) -> None:
        raise AssertionError("a host node has no controls")

    def close(self) -> None:
        self._pipeline.stop()


def on_host(make: Any) -> OakCamera:
    """A camera whose pipeline, created by `make`, uses no device."""

    def factory(device: str, wanted: Sequence[SocketRequest]) -> HostNode:
        pipeline = oak.load().Pipeline(False)
        return HostNode(pipeline, make(pipeline).out.createOutputQueue(maxSize=64, blocking=False))

    return OakCamera(CameraSpec(Eye.PRIMARY, "oak"), SystemClock(), factory=factory)


def test_jpegs_stamps_and_drops_pass_through_the_queues_of_depthai() -> None:
    dai = oak.load()

    class Source(dai.node.ThreadedHostNode):  # type: ignore[misc,name-defined]
        def __init__(self) -> None:
            dai.node.ThreadedHostNode.__init__(self)
            self.out = self.createOutput()

        def run(self) -> None:
            for k in (0, 1, 4, 5):
                self.out.send(encoded(k, time.monotonic_ns(), JPEG % k))
            done.set()

    done = threading.Event()
    before_ns = time.monotonic_ns()
    camera = on_host(lambda pipeline: pipeline.create(Source))
    camera.start()
    frames = [camera.read(20.0) for _ in range(4)]
    # depthai's stop() holds the interpreter lock while it waits for a node written in Python
    assert done.wait(20.0)
    camera.stop()
    assert [f and f.sequence for f in frames] == [0, 1, 4, 5]
    assert [f and f.image for f in frames] == [JPEG % k for k in (0, 1, 4, 5)]
    # depthai rounds stamps to microseconds
    assert all(f and before_ns - 1000 <= f.t_ns <= time.monotonic_ns() for f in frames)
    assert (camera.stats().drops, camera.stats().host_stamped) == (2, 0)


def test_depthai_video_replay_gives_bgr_and_ends_as_a_lost_device(
    tmp_path: Path,
) -> None:
    dai, file = oak.load(), tmp_path / "drive.avi"
    writer = cv2.VideoWriter(str(file), cv2.VideoWriter.fourcc(*"MJPG"), 30, (64, 48))
    for k in range(6):
        writer.write(np.full((48, 64, 3), 20 + 30 * k, np.uint8))
    writer.release()

    def make(pipeline: Any) -> Any:
        node = pipeline.create(dai.node.ReplayVideo)
        node.setReplayVideoFile(file)
        node.setLoop(False)
        node.setFps(100.0)
        node.setOutFrameType(dai.ImgFrame.Type.NV12)
        return node

    camera = on_host(make)
    camera.start()
    frames = [camera.read(20.0) for _ in range(6)]
    assert camera.read(0.5) is None and not camera.connected
    camera.stop()
    levels = [float(f.bgr().mean()) for f in frames if f is not None]
    assert np.abs(np.subtract(levels, 20 + 30 * np.arange(6))).max() < 4
    assert all(f is not None and f.bgr().shape == (48, 64, 3) for f in frames)


def test_the_clock_of_depthai_is_host_monotonic() -> None:
    dai = oak.load()
    before_ns = time.monotonic_ns()
    clock_ns = dai.Clock.now() // timedelta(microseconds=1) * 1000
    assert before_ns - 1000 <= clock_ns <= time.monotonic_ns()


LOADED = """
import os, signal, sys
# a job in the background inherits an ignored SIGINT
signal.signal(signal.SIGINT, signal.default_int_handler)
from device.camera import CameraSpec, open_camera
from device.clock import SystemClock
from device.errors import CameraError
from device.frame import Eye
camera = open_camera(CameraSpec(Eye.PRIMARY, "oak", "NOSUCHDEVICE"), SystemClock())
assert "depthai" not in sys.modules, "depthai is loaded before it is needed"
try:
    camera.start()
except CameraError as error:
    print(error)
assert os.environ["DEPTHAI_TELEMETRY"] == os.environ["DEPTHAI_INSTALL_SIGNAL_HANDLER"] == "0"
assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
"""


def test_a_missing_device_gives_one_line_and_no_telemetry() -> None:
    done = subprocess.run(
        [sys.executable, "-c", LOADED], capture_output=True, text=True, check=True, timeout=60
    )
    (line,) = done.stdout.splitlines()
    assert line.startswith("primary camera oak:NOSUCHDEVICE: ")
    assert "no OAK device found" in line or "not found; plugged in" in line
    assert "Traceback" not in done.stderr
