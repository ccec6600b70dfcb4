"""Capture holds exactly the frames that the tracker's windows still need."""

from __future__ import annotations

import queue
from collections.abc import Iterator
from typing import Any

import cv2
import pytest

from calm_edge.config import FrontendConfig
from calm_edge.daemon import tracker_link
from calm_edge.daemon.messages import Ready
from calm_edge.daemon.ring import RingReader
from calm_edge.daemon.tracker_link import RING_SLOTS, TrackerLink
from calm_edge.daemon.tracker_process import TrackerWork
from calm_edge.types import SubmapWindow
from device.frame import Eye, Frame
from tests.frontend.plane_world import PlaneWorld, drive

CONFIG = FrontendConfig(n_max=6, n_overlap=2, first_window=4, max_keyframe_gap_s=0.1)
WORLD, POSES = PlaneWorld(), drive(60)
EVERY_NS = 33_000_000


class InlineChild:
    """The tracker in this process; it handles its messages when `handle` is called."""

    def __init__(self, _: str, __: Any, arguments: tuple[Any, ...], inbox: Any) -> None:
        name, slot_bytes, config, start = arguments
        self.alive, self.exit_code = True, None
        self._ring = RingReader(name, slot_bytes)
        self._work = TrackerWork(config, self._ring, start, lambda _: None)
        self._sent: list[Any] = []

    def send(self, message: Any) -> None:
        self._sent.append(message)

    def handle(self) -> list[Any]:
        """Handle all messages sent so far and return the answers."""
        sent, self._sent = self._sent, []
        return [answer for answer in map(self._work.handle, sent) if answer is not None]

    def kill(self) -> None:
        self.alive = False

    def stop(self, *_: object) -> None:
        self._ring.close()


class Bench:
    """The link, with frames of a drive at 30 Hz per eye."""

    def __init__(self) -> None:
        self.link = TrackerLink(CONFIG, queue.Queue(), lambda _: None)
        self.link.accept(Ready())
        self.offered: list[Frame] = []

    def offer(self, count: int) -> None:
        for i in range(len(self.offered) // 2, len(self.offered) // 2 + count):
            jpeg = cv2.imencode(".jpg", WORLD.render(POSES[i % len(POSES)]))[1].tobytes()
            for eye in Eye:
                t_ns = 10**9 + i * EVERY_NS + int(eye) * 10**7
                self.offered.append(Frame(eye, i, t_ns, jpeg))
                self.link.offer(self.offered[-1])

    def handle(self) -> list[SubmapWindow]:
        child: Any = self.link.child
        return [w for message in child.handle() for w in self.link.accept(message)[0]]


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    monkeypatch.setattr(tracker_link, "Child", InlineChild)
    bench = Bench()
    yield bench
    bench.link.stop()


def test_windows_get_their_frames_and_all_others_are_released(bench: Bench) -> None:
    windows: list[SubmapWindow] = []
    for _ in range(50):
        bench.offer(1)
        windows += bench.handle()
        # at most the keyframes of two windows, and the assistant frames of the longest pairing gap
        gap_frames = int(CONFIG.max_pair_gap_s * 1e9 / EVERY_NS) + 2
        assert bench.link.frames_held <= 2 * (2 * CONFIG.n_max) + gap_frames
    bench.link.flush()
    windows += bench.handle()
    assert bench.link.flushed and len(windows) > 3
    frames = {(frame.eye, frame.t_ns): frame for frame in bench.offered}
    for window in windows:
        for keyframe in window.keyframes():
            assert keyframe.frame is frames[keyframe.frame.eye, keyframe.frame.t_ns]


def test_a_suspended_tracker_holds_at_most_the_ring(bench: Bench) -> None:
    bench.offer(RING_SLOTS)
    assert bench.link.in_flight == bench.link.frames_held == RING_SLOTS
    assert bench.handle() and bench.link.in_flight == 0


def test_a_dead_tracker_holds_no_frames(bench: Bench) -> None:
    bench.offer(10)
    bench.handle()
    bench.offer(2)
    assert bench.link.frames_held > bench.link.in_flight == 4
    before: Any = bench.link.child
    before.kill()
    bench.link.pump()
    before.stop()
    assert bench.link.restarts == 1 and bench.link.frames_lost == 4
    assert bench.link.frames_held == 0
    # the next tracker continues the numbering of the first
    bench.offer(20)
    assert bench.handle()[0].n_overlap == 0
