"""Which windows and images are sent to the estimator."""

from __future__ import annotations

import queue
from collections.abc import Callable
from typing import Any
from unittest.mock import Mock

import pytest

from calm_edge.config import Config
from calm_edge.daemon import estimator_link
from calm_edge.daemon.estimator_link import IN_TIME_S, INBOX_WINDOWS, EstimatorLink
from calm_edge.daemon.messages import Expect, Finished, LeftOut, Process, Processed, Ready
from calm_edge.types import Keyframe, Metre, Submap, SubmapWindow
from device.frame import Eye, Frame

S = 1_000_000_000


class IdleChild:
    """A process that accepts every message and never answers."""

    def __init__(self, *_: object) -> None:
        self.alive, self.exit_code = True, None
        self.sent: list[Any] = []

    def send(self, message: Any) -> None:
        self.sent.append(message)


def window(number: int, ends_s: float) -> SubmapWindow:
    """Two primary keyframes, a second apart."""
    stamps = [int((ends_s - 1) * S), int(ends_s * S)]
    frames = [Frame(Eye.PRIMARY, i, t, b"") for i, t in enumerate(stamps)]
    return SubmapWindow(number, tuple(Keyframe(2 * number + f.sequence, f) for f in frames), (), 0)


class Bench:
    """The link on a fake clock; windows every 2 s, each ending with the current time."""

    def __init__(self, patch: pytest.MonkeyPatch, *, lockstep: bool = False) -> None:
        self.now_s, self.lines = 100.0, list[str]()
        patch.setattr(estimator_link, "Child", IdleChild)
        patch.setattr(estimator_link.time, "monotonic", lambda: self.now_s)
        self.link = EstimatorLink(
            Config(),
            queue.Queue(),
            self.lines.append,
            lockstep=lockstep,
            now_ns=lambda: int(self.now_s * S),
        )
        self.link.accept(Ready(expects_pictures=True))

    def windows(self, count: int, every_s: float = 2.0) -> None:
        for _ in range(count):
            self.link.offer(window(self.offered, self.now_s))
            self.now_s += every_s

    @property
    def offered(self) -> int:
        handed = [m.window.submap_id for m in self.handed]
        return max([*handed, *self.waiting, *self.link.left_to_map], default=-1) + 1

    @property
    def waiting(self) -> list[int]:
        return [w.submap_id for w in self.link._inbox]

    @property
    def handed(self) -> list[Process]:
        sent: list[Any] = self.link.child.sent  # type: ignore[attr-defined]
        return [message for message in sent if isinstance(message, Process)]

    def answer(self) -> int:
        """Report the current window as solved and return the id of the one sent next."""
        self.link.accept(Processed(self.handed[-1].window.submap_id, None))
        return self.handed[-1].window.submap_id


MakeBench = Callable[..., Bench]


@pytest.fixture
def make_bench(monkeypatch: pytest.MonkeyPatch) -> MakeBench:
    return lambda **options: Bench(monkeypatch, **options)


def test_the_newest_window_is_solved_first_if_the_next_would_be_late(
    make_bench: MakeBench,
) -> None:
    bench = make_bench()
    # solving the first takes as long as six others need to arrive
    bench.windows(7)
    assert bench.answer() == 6
    assert bench.link.left_to_map == [1, 2, 3, 4, 5] and bench.waiting == []
    assert bench.link.overtaken == 5
    bench.windows(7)
    assert bench.answer() == 13 and bench.link.overtaken == 11
    assert bench.lines == ["too slow for live poses: windows are skipped, run calm-edge map later"]


def test_while_lost_the_newest_window_is_solved_first(make_bench: MakeBench) -> None:
    bench = make_bench()
    bench.link.pose_lost = True
    bench.windows(3, every_s=0.1)
    assert bench.answer() == 2
    assert bench.link.left_to_map == [1]


def test_the_stamps_of_left_out_windows_are_sent(
    make_bench: MakeBench,
) -> None:
    bench = make_bench()
    bench.windows(7)
    bench.answer()
    left_out = bench.handed[-1].left_out
    assert [w.submap_id for w in left_out] == [1, 2, 3, 4, 5]
    assert left_out[0] == LeftOut(1, (101 * S, 102 * S))
    bench.windows(1)
    bench.answer()
    assert bench.handed[-1].left_out == ()


def test_windows_still_in_time_are_solved_in_order(make_bench: MakeBench) -> None:
    bench = make_bench()
    # solving took 3 s; the oldest waiting window has waited for 2 s
    bench.windows(2, every_s=1.0)
    bench.windows(1, every_s=1.0)
    assert IN_TIME_S >= 2.0 + 3.0
    assert bench.answer() == 1
    assert bench.answer() == 2
    assert bench.link.left_to_map == []


def test_the_duration_of_the_last_window_decides(make_bench: MakeBench) -> None:
    bench = make_bench()
    bench.windows(1, every_s=0.6 * IN_TIME_S)
    bench.windows(2, every_s=0.1)
    # with the same duration window 1 is in time; with a slightly longer one it is not
    assert bench.answer() == 1
    bench.windows(1, every_s=0.6 * IN_TIME_S)
    assert bench.answer() == 3
    assert bench.link.left_to_map == [2]


def test_a_single_waiting_window_is_not_left_out(make_bench: MakeBench) -> None:
    bench = make_bench()
    bench.link.pose_lost = True
    bench.windows(1, every_s=0.1)
    bench.windows(1, every_s=10 * IN_TIME_S)
    assert bench.answer() == 1


def test_in_lockstep_every_window_is_solved(make_bench: MakeBench) -> None:
    bench = make_bench(lockstep=True)
    bench.link.pose_lost = True
    bench.windows(9)
    assert [bench.answer() for _ in range(8)] == list(range(1, 9))


def test_keyframes_are_sent_ahead_unless_windows_wait(make_bench: MakeBench) -> None:
    bench = make_bench()
    keyframe = window(0, 100.0).primary[0].frame
    bench.link.expect(keyframe)
    bench.windows(1, every_s=0.1)
    bench.link.expect(keyframe)
    bench.windows(1, every_s=0.1)
    bench.link.expect(keyframe)
    sent = [type(message) for message in bench.link.child.sent]  # type: ignore[attr-defined]
    assert sent == [Expect, Process, Expect]


def test_keyframes_are_not_sent_ahead_without_a_network(
    make_bench: MakeBench,
) -> None:
    bench = make_bench()
    bench.link.accept(Ready())
    bench.link.expect(window(0, 100.0).primary[0].frame)
    assert not bench.link.child.sent  # type: ignore[attr-defined]


def test_after_the_last_frame_every_window_is_solved(make_bench: MakeBench) -> None:
    bench = make_bench()
    bench.windows(9)
    bench.link.capturing, bench.link.pose_lost = False, True
    assert [bench.answer() for _ in range(8)] == list(range(1, 9))
    assert bench.link.left_to_map == []


def test_the_stamps_of_windows_that_exceed_the_queue_are_sent(make_bench: MakeBench) -> None:
    bench = make_bench()
    bench.windows(INBOX_WINDOWS + 3)
    assert bench.link.left_to_map == [INBOX_WINDOWS + 1, INBOX_WINDOWS + 2]
    bench.answer()
    assert [w.submap_id for w in bench.handed[-1].left_out] == bench.link.left_to_map


def test_a_window_solved_at_last_is_not_unsolved(make_bench: MakeBench) -> None:
    bench = make_bench(lockstep=True)
    bench.windows(3)
    for _ in range(3):
        bench.answer()
    assert bench.link.unsolved == [0, 1, 2]
    submap = Mock(spec=Submap)
    submap.id = 1
    bench.link.accept(Finished((submap,), None, Metre()))
    assert bench.link.unsolved == [0, 2] and bench.link.solved_late == 1


def test_the_newest_window_is_refused_until_one_is_solved(make_bench: MakeBench) -> None:
    bench = make_bench(lockstep=True)
    bench.windows(3)
    assert bench.link.refused == ""
    bench.link.accept(Processed(0, None, "too dark"))
    assert bench.link.refused == "window 0 gave no sub-map: too dark"
    bench.link.accept(Processed(1, Mock(), ""))
    assert bench.link.refused == "" and bench.link.unsolved == [0]
