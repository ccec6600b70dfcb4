from __future__ import annotations

import pytest

from device.frame import Eye, Frame
from device.stream import Stream

PERIOD, DELAY = 1000, 40


def frame(sequence: int, t_ns: int) -> Frame:
    return Frame(Eye.PRIMARY, sequence, t_ns, b"")


def test_stamps_in_the_future_are_clamped_and_remain_the_frames_own() -> None:
    stream = Stream()
    admitted = [stream.admit(frame(k, t), now) for k, t, now in [(0, 100, 150), (1, 400, 200)]]
    assert [f.t_ns for f in admitted] == [100, 200] and all(f.own_stamp for f in admitted)
    assert (stream.stats.clamped, stream.stats.frames) == (1, 2)


@pytest.mark.parametrize("wrong", [PERIOD * 3, PERIOD * 3 - 1, 0, PERIOD])
def test_a_stamp_that_repeats_or_steps_back_becomes_arrival_less_the_usual_delay(
    wrong: int,
) -> None:
    stream = Stream()
    for k in range(4):
        stream.admit(frame(k, PERIOD * k), PERIOD * k + DELAY)
    for k in (4, 5):
        marked = stream.admit(frame(k, wrong), PERIOD * k + DELAY + 3)
        assert (marked.t_ns, marked.own_stamp) == (PERIOD * k + 3, False)
    after = stream.admit(frame(6, PERIOD * 6), PERIOD * 6 + DELAY)
    assert (after.t_ns, after.own_stamp) == (PERIOD * 6, True)
    assert stream.stats.clamped == 2


def test_a_frame_that_arrives_early_without_a_stamp_is_still_after_the_one_before() -> None:
    stream = Stream()
    for k in range(4):
        stream.admit(frame(k, PERIOD * k), PERIOD * k + DELAY)
    marked = stream.admit(frame(4, 0), PERIOD * 3 + DELAY + 1)
    assert (marked.t_ns, marked.own_stamp) == (PERIOD * 3 + 1, False)


def test_replayed_stamps_go_on_by_the_last_step() -> None:
    stream = Stream()
    stamps = [10**15, 10**15 + 7, 10**15 + 7, 10**15 + 20]
    admitted = [stream.admit(frame(k, t), None) for k, t in enumerate(stamps)]
    assert [f.t_ns - 10**15 for f in admitted] == [0, 7, 14, 20]
    assert [f.own_stamp for f in admitted] == [True, True, False, True]
    assert stream.stats.clamped == 1


def test_a_frame_with_a_valid_stamp_is_passed_unchanged() -> None:
    given = frame(0, 5)
    assert Stream().admit(given, 6) is given


def test_gaps_in_the_sequence_are_drops() -> None:
    stream = Stream()
    for sequence in (7, 8, 11, 12):
        stream.admit(frame(sequence, sequence), 100)
    assert stream.stats.drops == 2


def test_each_counter_is_separate() -> None:
    stream = Stream()
    stream.count("reconnects")
    stream.count("reconnects")
    stream.count("corrupt")
    assert (stream.stats.reconnects, stream.stats.corrupt, stream.stats.host_stamped) == (2, 1, 0)
