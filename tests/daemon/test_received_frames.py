"""Every frame is sent to the estimator once, and every window can be assembled there."""

from __future__ import annotations

import queue
from collections import Counter
from typing import Any

import numpy as np
import pytest

from calm_edge.config import Config
from calm_edge.daemon import estimator_link
from calm_edge.daemon.estimator_link import EstimatorLink
from calm_edge.daemon.messages import Expect, Process, Processed, Ready
from calm_edge.daemon.received_frames import ReceivedFrames
from calm_edge.recording.window_record import FrameKey, frame_key, of_window
from calm_edge.types import Keyframe, SubmapWindow
from device.frame import Eye, Frame

N_MAX, N_OVERLAP = 6, 2


def frame(eye: Eye, index: int) -> Frame:
    t_ns = 10**9 + index * 10**8 + int(eye) * 10**7
    return Frame(eye, index, t_ns, f"{eye} {index}".encode())


def window(number: int) -> SubmapWindow:
    """N_MAX keyframes per eye, N_OVERLAP of them from the preceding window."""
    first = number * (N_MAX - N_OVERLAP)
    views = [tuple(Keyframe(i, frame(eye, i)) for i in range(first, first + N_MAX)) for eye in Eye]
    return SubmapWindow(number, views[0], views[1], N_OVERLAP if number else 0)


class Receiver:
    """The estimator's end of the pipe, which answers on request."""

    def __init__(self, *_: object) -> None:
        self.alive, self.exit_code = True, None
        self.frames = ReceivedFrames()
        self.crossed: Counter[FrameKey] = Counter()
        self.windows: list[SubmapWindow] = []

    def send(self, message: Any) -> None:
        if isinstance(message, Expect):
            self.crossed[frame_key(message.keyframe)] += 1
            self.frames.add(message.keyframe)
        if isinstance(message, Process):
            self.crossed.update(map(frame_key, message.frames))
            self.windows.append(self.frames.window(message))

    def answer(self, link: EstimatorLink) -> None:
        link.accept(Processed(self.windows[-1].submap_id, None))


@pytest.fixture
def link(monkeypatch: pytest.MonkeyPatch) -> EstimatorLink:
    monkeypatch.setattr(estimator_link, "Child", Receiver)
    link = EstimatorLink(Config(), queue.Queue(), lambda _: None, lockstep=True)
    link.accept(Ready(expects_pictures=True))
    return link


def receiver(link: EstimatorLink) -> Receiver:
    assert isinstance(link.child, Receiver)
    return link.child


def test_a_frame_is_sent_once_ahead_or_with_its_window(link: EstimatorLink) -> None:
    there = receiver(link)
    rng = np.random.default_rng(0)
    for number in range(12):
        for keyframe in window(number).primary[N_OVERLAP if number else 0 :]:
            if rng.random() < 0.6:
                link.expect(keyframe.frame)
        link.offer(window(number))
        there.answer(link)
    assert there.windows == [window(number) for number in range(12)]
    assert set(there.crossed.values()) == {1}
    assert len(there.crossed) == 2 * (12 * (N_MAX - N_OVERLAP) + N_OVERLAP)
    # only the last window is kept
    assert len(there.frames) == 2 * N_MAX


def test_of_left_out_windows_only_frames_shared_with_others_are_sent(link: EstimatorLink) -> None:
    there = receiver(link)
    link.offer(window(0))
    for keyframe in window(1).primary[N_OVERLAP:]:
        link.expect(keyframe.frame)
    link.leave_to_map(window(1))
    there.answer(link)
    link.offer(window(2))
    assert there.windows == [window(0), window(2)]
    assert set(there.crossed.values()) == {1}
    ahead = set(window(1).primary[N_OVERLAP:]) - set(window(2).primary)
    needed = {key for w in there.windows for key in of_window(w).frame_keys}
    assert set(there.crossed) == needed | {frame_key(k.frame) for k in ahead}
    assert len(there.frames) == 2 * N_MAX


def test_a_restarted_process_is_sent_the_frames_it_needs(link: EstimatorLink) -> None:
    link.offer(window(0))
    link.offer(window(1))
    receiver(link).alive = False
    link.pump()
    there = receiver(link)
    assert link.lost == [0] and not there.windows
    link.accept(Ready())
    assert there.windows == [window(1)] and len(there.crossed) == 2 * N_MAX
