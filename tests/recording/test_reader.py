"""Reading intact, truncated and damaged recordings."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from calm_edge.recording import RecordingError, schema
from calm_edge.recording.reader import Recording
from device.frame import Eye
from tests.recording import samples

N = 12


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return samples.small_recording(tmp_path_factory.mktemp("recording") / "rec", N)


def test_everything_recorded_is_read_back_exactly(folder: Path) -> None:
    recording = Recording(folder)
    assert recording.losses == []
    for eye in Eye:
        assert list(recording.frames(eye)) == [samples.frame(eye, k) for k in range(N)]
        assert recording.frame_times(eye).tolist() == [samples.frame(eye, k).t_ns for k in range(N)]
    poses, updates = list(recording.poses()), list(recording.updates())
    assert len(poses) == N
    assert all(samples.same(p, samples.pose(k)) for k, p in enumerate(poses))
    assert len(updates) == 2
    assert all(samples.same(u, samples.update(k)) for k, u in enumerate(updates))
    assert [recording.window(w) for w in recording.windows()] == [
        samples.window(0),
        samples.window(1),
    ]
    assert recording.config == samples.config(chunk_bytes=8192, log_depth=True)
    assert recording.metadata["camera_primary"] == "usb-1"
    assert recording.metadata["backbone"] == samples.config().backbone.name
    assert {"version", "boot_id"} <= set(recording.metadata)
    assert recording.count(schema.POSE_LIVE) == N


def test_frames_of_both_eyes_are_merged_by_time(folder: Path) -> None:
    times = [f.t_ns for f in Recording(folder).frames()]
    assert len(times) == 2 * N
    assert times == sorted(times)


def test_a_single_file_can_be_opened(folder: Path) -> None:
    assert len(list(Recording(folder / "0000.mcap").poses())) == N


def test_random_access_reads_and_caches_few_bytes(folder: Path) -> None:
    recording = Recording(folder)
    for k in random.Random(1).sample(range(N), N):
        for eye in Eye:
            assert recording.frame(eye, k) == samples.frame(eye, k)
    with pytest.raises(RecordingError, match="assistant frame 99"):
        recording.frame(Eye.ASSISTANT, 99)
    with pytest.raises(RecordingError):
        recording.frame(Eye.PRIMARY, 0, t_ns=1)


def test_the_cache_is_bounded(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from calm_edge.recording import reader

    monkeypatch.setattr(reader, "_CACHE_BYTES", 20_000)
    recording = Recording(folder)
    assert len(list(recording.frames(Eye.PRIMARY))) == N
    assert sum(map(len, recording._cache.values())) <= 20_000


def test_missing_empty_and_foreign_files_raise_one_line(tmp_path: Path) -> None:
    empty, text, short = (tmp_path / n for n in ("empty.mcap", "text.mcap", "short.mcap"))
    empty.write_bytes(b"")
    text.write_text("not a recording, but longer than the magic")
    short.write_bytes(b"\x89MCAP")
    (tmp_path / "none").mkdir()
    for path in (empty, text, short, tmp_path / "none", tmp_path / "missing"):
        with pytest.raises(RecordingError) as error:
            Recording(path)
        assert str(path) in str(error.value)
        assert "\n" not in str(error.value)


def test_one_unreadable_segment_does_not_hide_the_others(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "0000.mcap").write_bytes((folder / "0000.mcap").read_bytes())
    (tmp_path / "0001.mcap.part").write_bytes(b"")
    recording = Recording(tmp_path)
    assert len(list(recording.frames(Eye.PRIMARY))) == N
    assert len(recording.losses) == 1
    assert "0001.mcap.part" in recording.losses[0]


def is_prefix(found: list, expected: list) -> bool:
    return len(found) <= len(expected) and all(map(samples.same, found, expected))


def test_any_truncation_gives_a_prefix_or_one_error_line(folder: Path, tmp_path: Path) -> None:
    whole = (folder / "0000.mcap").read_bytes()
    cut_file = tmp_path / "0000.mcap.part"
    rng = random.Random(7)
    cuts = [0, 1, 8, 9, len(whole) - 1, *(rng.randrange(len(whole)) for _ in range(60))]
    recovered = 0
    for cut in cuts:
        # half of them followed by zeros, as after a power cut
        cut_file.write_bytes(whole[:cut] + bytes(rng.choice([0, 5000])))
        try:
            recording = Recording(tmp_path)
        except RecordingError:
            assert cut < 8
            continue
        assert len(recording.losses) >= 1
        for eye in Eye:
            frames = list(recording.frames(eye))
            assert is_prefix(frames, [samples.frame(eye, k) for k in range(N)])
            recovered += len(frames)
        assert is_prefix(list(recording.poses()), [samples.pose(k) for k in range(N)])
        assert is_prefix(list(recording.updates()), [samples.update(k) for k in range(2)])
        for window in recording.windows():
            try:
                assert samples.same(recording.window(window), samples.window(window.submap_id))
            except RecordingError as error:
                assert "not in the recording" in str(error)
    # truncation at a random place loses half of the file on average, and not much more
    assert recovered > 0.3 * len(cuts) * 2 * N


def test_a_chunk_with_a_flipped_bit_is_left_out_and_reported(folder: Path, tmp_path: Path) -> None:
    whole = bytearray((folder / "0000.mcap").read_bytes())
    at = whole.index(samples.jpeg(2 * 6)) + 100
    whole[at] ^= 1
    path = tmp_path / "0000.mcap"
    path.write_bytes(whole)
    recording = Recording(path)
    assert recording.losses == []
    frames = list(recording.frames(Eye.PRIMARY))
    assert 0 < len(frames) < N
    assert all(f == samples.frame(Eye.PRIMARY, f.sequence) for f in frames)
    assert 6 not in [f.sequence for f in frames]
    assert len(recording.losses) == 1
    with pytest.raises(RecordingError):
        recording.frame(Eye.PRIMARY, 6)


def test_random_damage_raises_only_recording_errors(folder: Path, tmp_path: Path) -> None:
    whole = (folder / "0000.mcap").read_bytes()
    rng = random.Random(3)
    path = tmp_path / "damaged.mcap"
    expected = {(e, k): samples.frame(e, k) for e in Eye for k in range(N)}
    for _ in range(40):
        data = bytearray(whole)
        for _ in range(5):
            data[rng.randrange(len(data))] = rng.randrange(256)
        path.write_bytes(data)
        try:
            recording = Recording(path)
            for frame in recording.frames():
                assert frame == expected[frame.eye, frame.sequence]
            list(recording.updates())
            assert recording.config is not None
        except RecordingError:
            continue
