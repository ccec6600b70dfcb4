"""Unix time in the files of a recording, and the user's stamps in its messages."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from calm_edge.recording import RecordingError, schema, time_base
from calm_edge.recording.reader import Recording
from calm_edge.recording.time_base import DATED_NS, TimeBase, WallClock
from calm_edge.recording.writer import RecordingWriter
from device.frame import Eye
from tests.recording import samples

S = 10**9
DATE_NS = 1_400_000_000 * S


def written(folder: Path, base: TimeBase, **options: object) -> list[tuple[str, int, int, object]]:
    """Topics, log times, publish times and messages of a small recording, by a standard reader."""
    with RecordingWriter(folder, samples.config(), time_base=base, **options) as writer:  # type: ignore[arg-type]
        for k in range(4):
            for eye in Eye:
                writer.write_frame(samples.frame(eye, k))
            writer.write_pose(samples.pose(k))
        writer.write_update(samples.update())
    with (folder / "0000.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        topics = [*schema.IMAGE_TOPICS.values(), schema.POSE_LIVE, schema.SUBMAP, schema.TF]
        found = reader.iter_decoded_messages(topics, log_time_order=False)
        return [(c.topic, m.log_time, m.publish_time, d) for _, c, m, d in found]


def test_stamps_that_a_recording_cannot_hold_are_refused_with_a_remedy() -> None:
    with pytest.raises(RecordingError, match=r"-1000000000 s, before .*; add a constant"):
        time_base.of_stamps(S, S - DATED_NS - 53_315_200 * S, lockstep=True)


@pytest.mark.parametrize("lossless", [True, False])
def test_log_times_are_in_order_and_stamps_are_those_of_the_source(
    tmp_path: Path, lossless: bool
) -> None:
    base = TimeBase(origin_ns=S, epoch_ns=DATE_NS, clock=WallClock.RUN)
    now = iter(range(samples.T0_NS, samples.T0_NS + 10**15, 7))
    messages = written(tmp_path, base, lossless=lossless, now_ns=lambda: next(now))
    logged = [log for _, log, _, _ in messages]
    assert logged == sorted(logged) and logged[0] >= DATE_NS + samples.T0_NS
    for topic, log, published, message in messages:
        if topic == schema.IMAGE_TOPICS[Eye.PRIMARY]:
            assert message.timestamp.ToNanoseconds() == published - DATE_NS - S  # type: ignore[attr-defined]
            assert not lossless or log == published
    # the older of two messages has the log time of the newer one, and keeps its own
    *_, submap = [m for m in messages if m[0] == schema.SUBMAP]
    assert submap[2] < submap[1]
    recording = Recording(tmp_path)
    expected = [samples.frame(Eye.PRIMARY, k) for k in range(4)]
    assert list(recording.frames(Eye.PRIMARY)) == expected
    assert recording.frame(Eye.PRIMARY, 2, expected[2].t_ns) == expected[2]
    assert recording.origin_ns == S
    assert recording.metadata[time_base.CLOCK_KEY] == "start of the run"


def test_stamps_that_are_dates_are_kept() -> None:
    base = time_base.of_stamps(S, DATE_NS + S, lockstep=False)
    assert base == TimeBase(S, -S, WallClock.SOURCE)


def test_stamps_from_zero_are_counted_from_the_start_of_the_run_or_a_fixed_day() -> None:
    before = time.time_ns()
    base = time_base.of_stamps(S, S, lockstep=False)
    assert before <= base.epoch_ns + S <= time.time_ns() and base.clock is WallClock.RUN
    base = time_base.of_stamps(S, S + 5, lockstep=True)
    assert base.epoch_ns + S + 5 == DATED_NS + 5 and base.clock is WallClock.UNDATED


def test_a_live_drive_has_unix_stamps_and_says_whether_its_clock_is_synchronised(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(time_base, "synchronised", lambda: False)
    base = time_base.live()
    assert abs(time.monotonic_ns() - base.origin_ns - time.time_ns()) < S
    assert base.clock is WallClock.UNSYNCHRONISED and base.epoch_ns == -base.origin_ns


def test_a_clock_set_during_the_drive_moves_the_stamps(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    base = TimeBase(-70, 70, WallClock.UNSYNCHRONISED)
    readings = iter([(False, 1070), (True, DATE_NS), (False, DATE_NS + 5)])

    def reading(t_ns: int, realtime_ns: int, monotonic_ns: int) -> schema.LogMessage:
        known, unix = next(readings, (False, 0))
        pair = {"realtime_ns": unix, "monotonic_ns": 1000, "synchronised": known}
        return schema.json_message(schema.CLOCK, t_ns, pair)

    monkeypatch.setattr(schema, "clock_message", reading)
    with RecordingWriter(tmp_path, samples.config(flush_s=0.02), time_base=base):
        time.sleep(0.3)
    assert Recording(tmp_path).origin_ns == 1000 - DATE_NS
