"""What every camera driver must do, whichever it is: one suite, back to back over all of them."""

from __future__ import annotations

from collections.abc import Callable, Collection
from itertools import pairwise
from typing import Any

import pytest

from device.camera import DRIVERS, Camera, CameraSpec, open_camera, refuse_same_device
from device.errors import CameraError
from device.frame import Eye, Frame
from tests.device.fake_oak import FakeOak, encoded
from tests.device.fake_video import JPEG, MONOTONIC, FakeCamera, FakeVideoIO, Shot
from tests.manual_clock import ManualClock

PERIOD_NS = 100_000_000
START_NS = 7_000_000_000
Shots = list[tuple[int, int]]
Build = Callable[..., Camera]


def replay(clock: ManualClock, shots: Shots) -> Camera:
    """A clock that runs on the time of the stamps."""
    frames = [Frame(Eye.ASSISTANT, s, clock.now_ns() + t, JPEG % s) for s, t in shots]
    return open_camera(CameraSpec(Eye.ASSISTANT, "replay"), clock, frames=frames)


def v4l2(clock: ManualClock, shots: Shots, spoilt: Collection[int] = ()) -> Camera:
    """A kernel whose camera is due and stamped at the same moments.

    spoilt: numbers of the images that are no JPEG.
    """
    device = FakeCamera("usb-1")
    for s, t in shots:
        stamp_ns = clock.now_ns() + t
        data = b"" if s in spoilt else JPEG % s
        device.shots.append(Shot(stamp_ns, s, data, stamp_ns, MONOTONIC))
    io = FakeVideoIO(clock, {"/dev/video0": device})
    return open_camera(CameraSpec(Eye.ASSISTANT, "v4l2", "usb-1"), clock, io=io)


def oak(clock: ManualClock, shots: Shots, spoilt: Collection[int] = ()) -> Camera:
    """A device whose encoder sends depthai's own messages, stamped on the host's clock."""
    device = FakeOak(clock)
    for s, t in shots:
        stamp_ns = clock.now_ns() + t
        data = b"no" if s in spoilt else JPEG % s
        device.film("CAM_A", stamp_ns, encoded(s, stamp_ns, data))
    return open_camera(CameraSpec(Eye.ASSISTANT, "oak", "OAK1"), clock, factory=device.factory)


BUILDS: dict[str, Build] = {"oak": oak, "replay": replay, "v4l2": v4l2}
LIVE = sorted(set(BUILDS) - {"replay"})
STEADY: Shots = [(s, s * PERIOD_NS) for s in range(6)]


@pytest.fixture
def clock() -> ManualClock:
    return ManualClock(START_NS)


@pytest.fixture(params=sorted(DRIVERS))
def build(request: pytest.FixtureRequest) -> Build:
    return BUILDS[request.param]


def read_all(camera: Camera) -> list[Frame]:
    frames = []
    while (frame := camera.read(1.0)) is not None:
        frames.append(frame)
    return frames


def test_frames_come_in_order_on_the_host_clock(build: Build, clock: ManualClock) -> None:
    camera = build(clock, STEADY)
    camera.start()
    frames = read_all(camera)
    assert [f.sequence for f in frames] == [0, 1, 2, 3, 4, 5]
    assert [f.t_ns for f in frames] == [START_NS + s * PERIOD_NS for s in range(6)]
    assert all(f.image == JPEG % f.sequence and f.eye is Eye.ASSISTANT for f in frames)
    assert camera.stats().frames == 6
    assert camera.stats().clamped == camera.stats().drops == camera.stats().reconnects == 0


def test_a_frame_is_not_handed_over_before_its_time(build: Build, clock: ManualClock) -> None:
    camera = build(clock, [(0, 0), (1, PERIOD_NS)])
    camera.start()
    camera.read(1.0)
    frame = camera.read(1.0)
    assert frame is not None and clock.now_ns() == frame.t_ns == START_NS + PERIOD_NS


def test_stamps_strictly_increase_whatever_the_source_says(
    build: Build, clock: ManualClock
) -> None:
    camera = build(clock, [(0, 0), (1, PERIOD_NS), (2, PERIOD_NS), (3, PERIOD_NS // 2)])
    camera.start()
    stamps = [f.t_ns for f in read_all(camera)]
    assert len(stamps) == 4 and all(b > a for a, b in pairwise(stamps))
    assert camera.stats().clamped == 2


def test_timeout_gives_none_at_its_time_and_loses_nothing(build: Build, clock: ManualClock) -> None:
    camera = build(clock, [(0, 0), (1, 10 * PERIOD_NS)])
    camera.start()
    assert camera.read(0.0) is not None
    before_ns = clock.now_ns()
    assert camera.read(0.25) is None
    assert clock.now_ns() - before_ns == 250_000_000
    assert camera.read(0.0) is None
    frame = camera.read(1.0)
    assert frame is not None and frame.sequence == 1


def test_gaps_are_counted_as_drops(build: Build, clock: ManualClock) -> None:
    camera = build(clock, [(s, s * PERIOD_NS) for s in (0, 1, 4, 5, 7)])
    camera.start()
    assert len(read_all(camera)) == 5
    assert camera.stats().drops == 3


def test_stop_is_idempotent_and_ends_the_frames(build: Build, clock: ManualClock) -> None:
    camera = build(clock, STEADY)
    camera.stop()
    camera.start()
    camera.start()
    assert camera.connected
    assert camera.read(1.0) is not None
    camera.stop()
    camera.stop()
    assert not camera.connected
    assert camera.read(1.0) is None
    assert camera.stats().frames == 1


def test_nothing_is_read_before_start(build: Build, clock: ManualClock) -> None:
    camera = build(clock, STEADY)
    assert not camera.connected
    assert camera.read(0.0) is None
    assert not camera.exhausted


def test_only_a_replay_ever_ends(build: Build, clock: ManualClock) -> None:
    camera = build(clock, STEADY)
    camera.start()
    assert not camera.exhausted
    read_all(camera)
    assert camera.exhausted is (camera.spec.driver == "replay")


@pytest.mark.parametrize("name", LIVE)
def test_a_live_camera_measures_its_rate(name: str, clock: ManualClock) -> None:
    camera = BUILDS[name](clock, [(s, s * 2 * PERIOD_NS) for s in range(50)])
    camera.start()
    read_all(camera)
    assert camera.settings["measured_hz"] == 5.0
    assert any("delivers 5.0 Hz, not 10" in remark for remark in camera.remarks)


@pytest.mark.parametrize("name", LIVE)
def test_a_live_camera_counts_a_corrupt_image_once(name: str, clock: ManualClock) -> None:
    camera = BUILDS[name](clock, STEADY, (2, 3))
    camera.start()
    assert [frame.sequence for frame in read_all(camera)] == [0, 1, 4, 5]
    assert (camera.stats().corrupt, camera.stats().drops) == (2, 0)


@pytest.mark.parametrize("name", LIVE)
def test_a_live_camera_without_a_usable_image_is_reopened(name: str, clock: ManualClock) -> None:
    camera = BUILDS[name](clock, [(s, s * PERIOD_NS) for s in range(60)], range(5, 60))
    camera.start()
    read_all(camera)
    while clock.now_ns() < START_NS + 50 * PERIOD_NS:
        camera.read(0.5)
    assert camera.stats().reconnects == 1 and camera.stats().frames == 5


def test_one_device_for_both_cameras_is_refused(clock: ManualClock) -> None:
    first, second = v4l2(clock, STEADY), v4l2(clock, STEADY)
    refuse_same_device([first, replay(clock, STEADY), replay(clock, STEADY)])
    for camera in (first, second):
        camera.start()
    with pytest.raises(CameraError, match=r"assistant camera v4l2:usb-1: is used for both cameras"):
        refuse_same_device([first, second])


def test_every_driver_is_under_contract() -> None:
    known: dict[str, Any] = DRIVERS
    assert set(BUILDS) == set(known)
