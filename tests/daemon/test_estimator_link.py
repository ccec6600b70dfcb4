"""Which windows and which pictures the estimator is sent."""

from __future__ import annotations

import queue
from collections.abc import Callable
from typing import Any

import pytest

from calm_edge.config import Config
from calm_edge.daemon import estimator_link
from calm_edge.daemon.estimator_link import IN_TIME_S, INBOX_WINDOWS, EstimatorLink
from calm_edge.daemon.messages import Expect, LeftOut, Process, Processed, Ready
from calm_edge.types import Keyframe, SubmapWindow
from device.frame import Eye, Frame

S = 1_000_000_000


class IdleChild:
    """A process that takes everything and answers nothing."""

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
    """The link on a clock of its own; a window each 2 s, its newest keyframe just exposed."""

    def __init__(self, patch: pytest.MonkeyPatch, *, lockstep: bool = False) -> None:
        self.now_s, self.said = 100.0, list[str]()
        patch.setattr(estimator_link, "Child", IdleChild)
        patch.setattr(estimator_link.time, "monotonic", lambda: self.now_s)
        self.link = EstimatorLink(
            Config(),
            queue.Queue(),
            self.said.append,
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
        """The window in hand is solved; the one that is handed over then."""
        self.link.accept(Processed(self.handed[-1].window.submap_id, None))
        return self.handed[-1].window.submap_id


MakeBench = Callable[..., Bench]


@pytest.fixture
def make_bench(monkeypatch: pytest.MonkeyPatch) -> MakeBench:
    return lambda **options: Bench(monkeypatch, **options)


def test_the_newest_window_goes_first_when_the_next_would_be_too_late(
    make_bench: MakeBench,
) -> None:
    bench = make_bench()
    # the first takes as long as six others need to come
    bench.windows(7)
    assert bench.answer() == 6
    assert bench.link.left_to_map == [1, 2, 3, 4, 5] and bench.waiting == []
    assert bench.link.overtaken == 5
    bench.windows(7)
    assert bench.answer() == 13 and bench.link.overtaken == 11
    assert bench.said == ["windows come too late to give a pose: late ones are left to map"]


def test_without_a_pose_it_goes_first_at_once(make_bench: MakeBench) -> None:
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


def test_windows_that_are_still_in_time_are_kept(make_bench: MakeBench) -> None:
    bench = make_bench()
    # took 3 s; the oldest that waits has waited 2 s
    bench.windows(2, every_s=1.0)
    bench.windows(1, every_s=1.0)
    assert IN_TIME_S >= 2.0 + 3.0
    assert bench.answer() == 1
    assert bench.answer() == 2
    assert bench.link.left_to_map == []


def test_how_long_the_last_one_took_counts(make_bench: MakeBench) -> None:
    bench = make_bench()
    bench.windows(1, every_s=0.6 * IN_TIME_S)
    bench.windows(2, every_s=0.1)
    # so long again and window 1 would be in time; a little longer, and it would not
    assert bench.answer() == 1
    bench.windows(1, every_s=0.6 * IN_TIME_S)
    assert bench.answer() == 3
    assert bench.link.left_to_map == [2]


def test_a_single_window_is_never_left_out(make_bench: MakeBench) -> None:
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


def test_keyframes_are_not_sent_ahead_where_they_are_of_no_use(
    make_bench: MakeBench,
) -> None:
    bench = make_bench()
    bench.link.accept(Ready())
    bench.link.expect(window(0, 100.0).primary[0].frame)
    assert not bench.link.child.sent  # type: ignore[attr-defined]


def test_when_frames_have_ended_every_window_is_solved(make_bench: MakeBench) -> None:
    bench = make_bench()
    bench.windows(9)
    bench.link.capturing, bench.link.pose_lost = False, True
    assert [bench.answer() for _ in range(8)] == list(range(1, 9))
    assert bench.link.left_to_map == []


def test_the_stamps_of_windows_beyond_the_queue_are_sent(make_bench: MakeBench) -> None:
    bench = make_bench()
    bench.windows(INBOX_WINDOWS + 3)
    assert bench.link.left_to_map == [INBOX_WINDOWS + 1, INBOX_WINDOWS + 2]
    bench.answer()
    assert [w.submap_id for w in bench.handed[-1].left_out] == bench.link.left_to_map
