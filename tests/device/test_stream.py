from __future__ import annotations

from device.frame import Eye, Frame
from device.stream import Stream


def frame(sequence: int, t_ns: int) -> Frame:
    return Frame(Eye.PRIMARY, sequence, t_ns, b"")


def test_stamps_in_the_future_or_out_of_order_are_clamped_and_counted() -> None:
    stream = Stream()
    stamps = [
        stream.admit(frame(k, t), now).t_ns
        for k, (t, now) in enumerate([(100, 150), (400, 200), (90, 300), (250, 300)])
    ]
    assert stamps == [100, 200, 201, 250]
    assert stream.stats.clamped == 2
    assert stream.stats.frames == 4


def test_recorded_stamps_are_only_clamped_to_their_order() -> None:
    stream = Stream()
    assert stream.admit(frame(0, 10**15), None).t_ns == 10**15
    assert stream.admit(frame(1, 10**15), None).t_ns == 10**15 + 1
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
