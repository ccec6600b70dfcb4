from __future__ import annotations

from itertools import pairwise

import pytest

from device.camera import CameraSpec
from device.clock import ManualClock
from device.drivers.replay import ReplayCamera, ReplayFaults
from device.errors import CameraError
from device.frame import Eye, Frame

PERIOD_NS = 100_000_000
EPOCH_NS = 1_600_000_000_000_000_000


def recording(n: int, eye: Eye = Eye.PRIMARY, offset_ns: int = 0) -> list[Frame]:
    return [Frame(eye, k, EPOCH_NS + offset_ns + k * PERIOD_NS, b"x") for k in range(n)]


def play(
    frames: list[Frame], faults: ReplayFaults | None = None, paced: bool = False
) -> tuple[ReplayCamera, list[Frame]]:
    camera = ReplayCamera(
        CameraSpec(frames[0].eye, "replay"),
        ManualClock(50),
        frames=frames,
        epoch_ns=EPOCH_NS,
        paced=paced,
        faults=faults,
    )
    camera.start()
    read = []
    while not camera.exhausted:
        if (frame := camera.read(0.05)) is not None:
            read.append(frame)
    return camera, read


def test_unpaced_frames_are_unchanged_and_take_no_time() -> None:
    clock = ManualClock(3)
    frames = recording(5)
    camera = ReplayCamera(CameraSpec(Eye.PRIMARY, "replay"), clock, frames=frames, paced=False)
    camera.start()
    assert [camera.read(1.0) for _ in range(5)] == frames
    assert clock.now_ns() == 3
    assert not camera.exhausted
    assert camera.read(1.0) is None and camera.exhausted


def test_unpaced_latest_reads_a_single_frame() -> None:
    camera = ReplayCamera(
        CameraSpec(Eye.PRIMARY, "replay"), ManualClock(), frames=recording(3), paced=False
    )
    camera.start()
    assert [f.sequence for f in iter(lambda: camera.latest(0), None)] == [0, 1, 2]


def test_two_replays_share_one_timeline() -> None:
    clock = ManualClock(1000)
    cameras = [
        ReplayCamera(
            CameraSpec(eye, "replay"),
            clock,
            frames=recording(2, eye, offset_ns),
            epoch_ns=EPOCH_NS,
            origin_ns=2000,
        )
        for eye, offset_ns in ((Eye.PRIMARY, 0), (Eye.ASSISTANT, 17_000_000))
    ]
    cameras[0].start()
    clock.advance(5)
    cameras[1].start()
    stamps = [f.t_ns for c in cameras for _ in range(2) if (f := c.read(1.0)) is not None]
    assert stamps == [2000 + t for t in (0, PERIOD_NS, 17_000_000, PERIOD_NS + 17_000_000)]


def test_without_an_epoch_the_first_frame_is_due_at_once() -> None:
    clock = ManualClock(77)
    camera = ReplayCamera(CameraSpec(Eye.PRIMARY, "replay"), clock, frames=recording(1))
    camera.start()
    frame = camera.read(0.0)
    assert frame is not None and frame.t_ns == 77


def test_frames_are_iterated_lazily() -> None:
    pulled = 0

    def lazy() -> object:
        nonlocal pulled
        for frame in recording(100):
            pulled += 1
            yield frame

    camera = ReplayCamera(
        CameraSpec(Eye.PRIMARY, "replay"),
        ManualClock(),
        frames=lazy(),  # type: ignore[arg-type]
    )
    camera.start()
    camera.read(0.0)
    camera.read(0.0)
    assert pulled == 2


def test_drops_are_reproducible_counted_and_at_the_set_rate() -> None:
    camera, first = play(recording(1000), ReplayFaults(drop=0.3, seed=4))
    _, again = play(recording(1000), ReplayFaults(drop=0.3, seed=4))
    _, other = play(recording(1000), ReplayFaults(drop=0.3, seed=5))
    assert first == again != other
    assert 240 < 1000 - len(first) < 360
    assert camera.stats().drops == first[-1].sequence - first[0].sequence + 1 - len(first)


def test_the_eyes_do_not_drop_the_same_frames() -> None:
    faults = ReplayFaults(drop=0.5)
    _, primary = play(recording(100), faults)
    _, assistant = play(recording(100, Eye.ASSISTANT), faults)
    assert [f.sequence for f in primary] != [f.sequence for f in assistant]


@pytest.mark.parametrize("paced", [False, True])
def test_a_freeze_stops_frames_without_a_reconnect(paced: bool) -> None:
    camera, frames = play(
        recording(10), ReplayFaults(freeze=(2 * PERIOD_NS, 5 * PERIOD_NS)), paced=paced
    )
    assert [f.sequence for f in frames] == [0, 1, 5, 6, 7, 8, 9]
    assert camera.stats().reconnects == 0


@pytest.mark.parametrize("paced", [False, True])
def test_disconnect_counts_one_reconnect(paced: bool) -> None:
    camera, frames = play(
        recording(10), ReplayFaults(disconnect=(2 * PERIOD_NS, 5 * PERIOD_NS)), paced=paced
    )
    assert [f.sequence for f in frames] == [0, 1, 5, 6, 7, 8, 9]
    assert camera.stats().reconnects == 1


def test_connected_is_false_while_the_camera_is_gone() -> None:
    clock = ManualClock(10)
    camera = ReplayCamera(
        CameraSpec(Eye.PRIMARY, "replay"),
        clock,
        frames=recording(10),
        faults=ReplayFaults(disconnect=(PERIOD_NS // 2, 3 * PERIOD_NS)),
    )
    camera.start()
    seen = []
    while camera.read(0.1) is not None or not camera.exhausted:
        seen.append(camera.connected)
    assert seen[0] and seen[-1]
    assert seen.count(False) == 2


def test_jittered_stamps_stay_ordered_and_not_in_the_future() -> None:
    camera, frames = play(recording(200), ReplayFaults(jitter_ns=PERIOD_NS / 2), paced=True)
    stamps = [f.t_ns for f in frames]
    assert len(frames) == 200
    assert all(b > a for a, b in pairwise(stamps))
    assert camera.stats().clamped == 0
    errors = [t - 50 - f.sequence * PERIOD_NS for t, f in zip(stamps, frames, strict=True)]
    spread = (sum(e * e for e in errors) / len(errors)) ** 0.5
    assert 0.3 * PERIOD_NS < spread < 0.7 * PERIOD_NS


def test_a_frame_of_the_other_eye_raises() -> None:
    camera = ReplayCamera(
        CameraSpec(Eye.PRIMARY, "replay"), ManualClock(), frames=recording(1, Eye.ASSISTANT)
    )
    camera.start()
    with pytest.raises(CameraError, match=r"primary camera replay:.*frame of the assistant"):
        camera.read(0.0)
