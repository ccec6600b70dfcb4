from __future__ import annotations

import pytest

from device.camera import CameraSpec
from device.drivers.replay import ReplayCamera
from device.errors import CameraError
from device.frame import Eye, Frame, Unusable
from tests.manual_clock import ManualClock

PERIOD_NS = 100_000_000
EPOCH_NS = 1_600_000_000_000_000_000
SPEC = CameraSpec(Eye.PRIMARY, "replay")


def recording(n: int, eye: Eye = Eye.PRIMARY) -> list[Frame]:
    return [Frame(eye, k, EPOCH_NS + k * PERIOD_NS, b"x") for k in range(n)]


def test_unpaced_frames_are_unchanged_and_take_no_time() -> None:
    clock = ManualClock(3)
    frames = recording(5)
    camera = ReplayCamera(SPEC, clock, frames=frames, paced=False)
    camera.start()
    assert [camera.read(1.0) for _ in range(5)] == frames
    assert clock.now_ns() == 3
    assert not camera.exhausted
    assert camera.read(1.0) is None and camera.exhausted


def test_paced_frames_keep_their_stamps_and_wait_for_them() -> None:
    clock = ManualClock(EPOCH_NS - 5)
    frames = recording(3)
    camera = ReplayCamera(SPEC, clock, frames=frames)
    camera.start()
    assert camera.read(0.0) is None
    for frame in frames:
        assert camera.read(1.0) == frame
        assert clock.now_ns() == frame.t_ns


def test_frames_are_iterated_lazily() -> None:
    pulled = 0

    def lazy() -> object:
        nonlocal pulled
        for frame in recording(100):
            pulled += 1
            yield frame

    camera = ReplayCamera(SPEC, ManualClock(EPOCH_NS), frames=lazy())  # type: ignore[arg-type]
    camera.start()
    camera.read(0.0)
    camera.read(0.0)
    assert pulled == 2


def test_a_frame_of_the_other_eye_raises() -> None:
    camera = ReplayCamera(SPEC, ManualClock(EPOCH_NS), frames=recording(1, Eye.ASSISTANT))
    camera.start()
    with pytest.raises(CameraError, match=r"primary camera replay:.*frame of the assistant"):
        camera.read(0.0)


def test_an_unusable_frame_is_left_out_counted_and_logged_once(
    caplog: pytest.LogCaptureFixture,
) -> None:
    whole = recording(6)
    frames = [
        Unusable(f.eye, f.sequence, f"{f.sequence}.jpg: not a JPEG") if f.sequence in (1, 4) else f
        for f in whole
    ]
    camera = ReplayCamera(SPEC, ManualClock(3), frames=frames, paced=False)
    camera.start()
    assert [camera.read(1.0) for _ in range(4)] == [whole[k] for k in (0, 2, 3, 5)]
    assert camera.read(1.0) is None and camera.exhausted
    assert camera.stats().corrupt == 2 and camera.stats().drops == 0
    assert [record.getMessage() for record in caplog.records] == ["1.jpg: not a JPEG"]
