"""Frames that get a pose when the tracker cannot keep up."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
import pytest

from calm_edge.config import FrontendConfig
from calm_edge.daemon.messages import Attach, Counters, Flush, FrameIn, Posed, Tracked
from calm_edge.daemon.ring import FrameRing, RingReader
from calm_edge.daemon.tracker_process import LATE_NS, MOVES_EVERY_NS, TrackerWork
from calm_edge.types import PoseStatus
from device.frame import Eye
from tests.frontend.plane_world import PlaneWorld, drive

MS = 1_000_000
EVERY_NS, START_NS = 33 * MS, 1_000_000_000
WORLD, POSES = PlaneWorld(), drive(60)


class Bench:
    """The tracker with a sub-map of its first frames, at 30 Hz."""

    def __init__(self) -> None:
        self.ring = FrameRing(60, 1 << 18)
        self.posed: list[Posed] = []
        config = FrontendConfig(max_keyframe_gap_s=0.05)
        reader = RingReader(self.ring.name, self.ring.slot_bytes)
        self.work = TrackerWork(config, reader, Counters(), self.posed.append)
        self._frames = 0

    def arrive(self, count: int, behind: int = 0) -> list[FrameIn]:
        """Let the next frames arrive, unhandled; their pictures are `behind` frames old."""
        frames = []
        for i in range(self._frames, self._frames + count):
            jpeg = cv2.imencode(".jpg", WORLD.render(POSES[i - behind]))[1].tobytes()
            slot = self.ring.put(jpeg)
            assert slot is not None
            frames.append(FrameIn(Eye.PRIMARY, i, START_NS + i * EVERY_NS, slot, len(jpeg)))
            self.work.on_arrival(frames[-1])
        self._frames += count
        return frames

    def handle(self, frames: list[FrameIn]) -> list[bool]:
        """Handle frames; return for each whether it was too late for a pose."""
        answers = [self.work.handle(frame) for frame in frames]
        assert all(isinstance(answer, Tracked) for answer in answers)
        return [answer.late for answer in answers]

    def posed_stamps(self) -> list[int]:
        return [message.sample.t_ns for message in self.posed]


@pytest.fixture
def bench() -> Iterator[Bench]:
    """Ten frames have been tracked and a sub-map of them is attached."""
    bench = Bench()
    for _ in range(10):
        assert bench.handle(bench.arrive(1)) == [False]
    assert len(bench.posed) == 10
    keyframes = [(p.keyframe_id, i) for i, p in enumerate(bench.work._tracker._past)]
    known = [(k, i) for k, i in keyframes if k is not None]
    ids, at = [k for k, _ in known], [i for _, i in known]
    stamps = [START_NS + i * EVERY_NS for i in at]
    assert bench.work.handle(Attach(WORLD.update(0, ids, stamps, POSES[at]))).taken
    bench.posed.clear()
    yield bench
    bench.ring.close()


def test_late_frames_get_no_pose_and_the_newest_do(bench: Bench) -> None:
    frames = bench.arrive(8)
    newest = frames[-1].t_ns
    late = [newest - frame.t_ns > LATE_NS for frame in frames]
    assert bench.handle(frames) == late and sum(late) == 5
    assert bench.posed_stamps() == [
        f.t_ns for f, is_late in zip(frames, late, strict=True) if not is_late
    ]
    assert all(message.sample.status is PoseStatus.LIVE for message in bench.posed)


def test_tracking_survives_a_longer_delay(bench: Bench) -> None:
    # 1.5 s: five times the longest gap between two tracked frames
    frames = bench.arrive(45)
    assert sum(bench.handle(frames)) == 42
    assert [message.sample.status for message in bench.posed] == [PoseStatus.LIVE] * 3
    assert {message.sample.epoch for message in bench.posed} == {0}


def test_every_slot_is_returned(bench: Bench) -> None:
    frames = bench.arrive(20)
    assert [bench.work.handle(f).slot for f in frames] == [f.slot for f in frames]


def test_without_delay_every_frame_gets_a_pose(bench: Bench) -> None:
    for _ in range(20):
        assert bench.handle(bench.arrive(1)) == [False]
    assert len(bench.posed) == 20


def test_the_points_of_a_pose_come_with_it_twice_a_second(bench: Bench) -> None:
    for _ in range(45):
        bench.handle(bench.arrive(1))
    assert len(bench.posed) == 45
    with_points = [m for m in bench.posed if m.moves is not None]
    stamps = [message.sample.t_ns for message in with_points]
    assert len(stamps) in (3, 4) and min(np.diff(stamps)) >= MOVES_EVERY_NS
    moves = with_points[-1].moves
    assert moves is not None and moves.shape[1] == 4 and len(moves) > 50
    # the wall moves by some pixels from frame to frame, all of it about alike
    steps = moves[:, :2] - moves[:, 2:]
    usual = np.median(steps, axis=0)
    assert 0.1 < np.linalg.norm(usual) < 20
    assert np.linalg.norm(steps - usual, axis=1).max() < 6


def test_keyframes_are_reported_at_once(bench: Bench) -> None:
    frames = bench.arrive(12)
    named = [frame.t_ns for frame in frames if bench.work.handle(frame).is_keyframe]
    past = list(bench.work._tracker._past)[10:]
    assert named == [frame.t_ns for frame in past if frame.keyframe_id is not None]
    assert 0 < len(named) < 12


def test_a_repeated_picture_gets_no_pose_and_leaves_the_velocity_as_it_is(bench: Bench) -> None:
    repeats = []
    for i in range(24):
        (frame,) = bench.arrive(1, behind=i % 6 == 5)
        answer = bench.work.handle(frame)
        assert (answer.repeat is Eye.PRIMARY) == (i % 6 == 5)
        assert answer.repeat is None or not (answer.late or answer.is_keyframe or answer.windows)
        repeats += [frame.t_ns] if answer.repeat is not None else []
    assert len(repeats) == 4 and not set(repeats) & set(bench.posed_stamps())
    speeds = [float(np.linalg.norm(message.sample.velocity_c)) for message in bench.posed]
    truth = float(np.linalg.norm((POSES[1] - POSES[0])[:3, 3])) / (EVERY_NS / 1e9)
    assert len(speeds) == 20 and np.abs(np.array(speeds[6:]) / truth - 1).max() < 0.1


def put(bench: Bench, number: int, eye: Eye, picture: np.ndarray) -> Tracked:
    jpeg = cv2.imencode(".jpg", picture)[1].tobytes()
    slot = bench.ring.put(jpeg)
    assert slot is not None
    frame = FrameIn(eye, number, START_NS + number * EVERY_NS, slot, len(jpeg))
    bench.work.on_arrival(frame)
    answer = bench.work.handle(frame)
    bench.ring.release(slot)
    assert isinstance(answer, Tracked)
    return answer


@pytest.mark.parametrize("eye", list(Eye))
@pytest.mark.parametrize("scale", [(0.5, 0.5), (1.0, 0.75), (2.0, 2.0)])
def test_pictures_of_another_size_begin_anew(
    bench: Bench, eye: Eye, scale: tuple[float, float]
) -> None:
    """A camera that is reopened in another mode: no window holds pictures of both sizes."""
    size_of: dict[tuple[int, int], tuple[int, int]] = {}
    said, windows = [], []
    for i in range(10, 60):
        for each in Eye:
            picture = WORLD.render(POSES[i])
            if each is eye and i >= 40:
                picture = cv2.resize(picture, None, fx=scale[0], fy=scale[1])
            size_of[int(each), i] = picture.shape[1::-1]
            answer = put(bench, i, each, picture)
            said += [answer.resized] if answer.resized else []
            windows += answer.windows
    windows += bench.work.handle(Flush()).windows
    (line,) = said
    assert line.startswith(f"{eye.name.lower()} camera: its pictures change from ")
    assert "at frame 40" in line
    sizes = [
        {size_of.get((e, s), size_of[e, 10]) for e, s, _ in window.frame_keys if e == eye}
        for window in windows
    ]
    assert all(len(each) == 1 for each in sizes)
    assert {size for each in sizes for size in each} == {size_of[eye, 10], size_of[eye, 59]}
    later = [w for w, each in zip(windows, sizes, strict=True) if each == {size_of[eye, 59]}]
    assert later[0].n_overlap == 0
    # a sub-map of the former size does not disturb
    newest = [m.sample.status for m in bench.posed]
    assert newest[-1] is PoseStatus.LOST
