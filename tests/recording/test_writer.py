"""The recording writer while the disk works."""

from __future__ import annotations

import logging
import os
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from foxglove_schemas_protobuf.Log_pb2 import Log

from calm_edge.recording import RecordingError, schema
from calm_edge.recording import writer as writer_module
from calm_edge.recording.reader import Recording
from calm_edge.recording.retention import is_kept, set_kept
from calm_edge.recording.writer import RecordingWriter
from device.frame import Eye, Frame
from tests.recording import samples


def logged(folder: Path) -> list[str]:
    texts = []
    for _, data in Recording(folder)._messages(schema.LOG):
        log = Log()
        log.ParseFromString(data)
        texts.append(log.message)
    return texts


def until(condition: Callable[[], bool], timeout_s: float = 5) -> None:
    end = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end, "never happened"
        time.sleep(0.01)


def test_an_existing_recording_raises_and_is_not_changed(tmp_path: Path) -> None:
    for name in ("0000.mcap", "0007.mcap.part"):
        folder = tmp_path / name
        folder.mkdir()
        (folder / name).write_bytes(b"precious")
        with pytest.raises(RecordingError, match="already holds a recording"):
            RecordingWriter(folder, samples.config())
        assert [p.read_bytes() for p in folder.iterdir()] == [b"precious"]


def test_a_folder_that_cannot_be_written_raises_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(RecordingError, match="cannot be written"):
        RecordingWriter(tmp_path / "file", samples.config())
    with pytest.raises(RecordingError, match="cannot be written"):
        RecordingWriter(tmp_path / "file" / "below", samples.config())


def test_segments_end_by_time_and_can_be_read_alone(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path, samples.config(segment_s=0.25, flush_s=0.1)) as writer:
        for k in range(10):
            writer.write_frame(samples.frame(Eye.PRIMARY, k))
            time.sleep(0.08)
    files = sorted(p.name for p in tmp_path.iterdir())
    assert len(files) >= 3
    assert files == [f"{i:04d}.mcap" for i in range(len(files))]
    whole = Recording(tmp_path)
    assert whole.losses == []
    assert [f.sequence for f in whole.frames(Eye.PRIMARY)] == list(range(10))
    assert whole.frame(Eye.PRIMARY, 9) == samples.frame(Eye.PRIMARY, 9)
    for name in files:
        assert Recording(tmp_path / name).config == samples.config(segment_s=0.25, flush_s=0.1)


def test_messages_are_in_the_file_within_flush_s_even_when_idle(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path, samples.config(flush_s=0.1)) as writer:
        time.sleep(0.05)
        writer.write_pose(samples.pose())
        until(lambda: len(list(Recording(tmp_path / "0000.mcap.part").poses())) == 1, 1)
        until(lambda: Recording(tmp_path).count(schema.CLOCK) >= 3, 2)
    pairs = list(Recording(tmp_path).json_messages(schema.CLOCK))
    offsets = [p["realtime_ns"] - p["monotonic_ns"] for p in pairs]
    assert max(offsets) - min(offsets) < 50_000_000


def test_log_and_status_are_read_back(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path, samples.config(), now_ns=lambda: 42) as writer:
        writer.write_log(logging.WARNING, "a camera is gone")
        writer.write_status({"state": "lagging", "frames": 7, "where": Path("x")})
    assert logged(tmp_path) == ["a camera is gone"]
    status = list(Recording(tmp_path).json_messages(schema.STATUS))
    assert status == [{"state": "lagging", "frames": 7, "where": "x"}]


def test_names_that_are_not_utf8_are_recorded(tmp_path: Path) -> None:
    name = os.fsdecode(b"s\xe9quence")
    with RecordingWriter(tmp_path, samples.config(), {"source": name}) as writer:
        writer.write_log(logging.WARNING, f"{name}/0.jpg: not a JPEG")
        writer.write_metadata(schema.CAMERAS_METADATA, {"primary": name})
    assert logged(tmp_path) == ["s\\udce9quence/0.jpg: not a JPEG"]
    assert Recording(tmp_path).metadata["source"] == "s\\udce9quence"


def test_camera_settings_are_in_every_segment_and_the_last_ones_apply(
    tmp_path: Path,
) -> None:
    with RecordingWriter(tmp_path, samples.config(segment_s=0.1, flush_s=0.02)) as writer:
        writer.write_frame(samples.frame(Eye.PRIMARY, 0))
        writer.write_metadata(schema.CAMERAS_METADATA, {"primary": '{"gain": "auto"}'})
        until(lambda: (tmp_path / "0001.mcap.part").exists())
        writer.write_metadata(schema.CAMERAS_METADATA, {"primary": '{"gain": 9}'})
        writer.write_frame(samples.frame(Eye.PRIMARY, 1))
        until(lambda: (tmp_path / "0002.mcap.part").exists())
    assert Recording(tmp_path / "0000.mcap").cameras(Eye.PRIMARY) == {"gain": "auto"}
    assert Recording(tmp_path / "0002.mcap").cameras(Eye.PRIMARY) == {"gain": 9}
    whole = Recording(tmp_path)
    assert whole.losses == [] and whole.cameras(Eye.PRIMARY) == {"gain": 9}
    assert whole.cameras(Eye.ASSISTANT) == {}
    assert [f.sequence for f in whole.frames(Eye.PRIMARY)] == [0, 1]


def test_an_item_that_cannot_be_encoded_loses_only_itself(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path, samples.config()) as writer:
        writer.write_frame(samples.frame(Eye.PRIMARY, 0))
        writer.write_frame(Frame(Eye.PRIMARY, 1, 5, np.zeros((0, 3, 3), np.uint8)))
        writer.write_frame(Frame(Eye.PRIMARY, 2, -5, b"jpeg"))
        writer.write_frame(samples.frame(Eye.PRIMARY, 3))
    assert [f.sequence for f in Recording(tmp_path).frames(Eye.PRIMARY)] == [0, 3]
    assert writer.health.unwritable == 2
    assert sum("could not be recorded" in text for text in logged(tmp_path)) == 2


class SlowDisk:
    """A disk whose writes block while `go` is cleared."""

    def __init__(self) -> None:
        self.go = threading.Event()
        self.go.set()

    def __call__(self, fd: int, data: bytes) -> int:
        assert self.go.wait(20)
        return os.write(fd, data)


def test_a_slow_disk_does_not_block_and_images_are_dropped_last(tmp_path: Path) -> None:
    disk = SlowDisk()
    settings = samples.config(chunk_bytes=1024, flush_s=0.05)
    writer = RecordingWriter(tmp_path, settings, queue_bytes=60_000, write=disk)
    time.sleep(0.1)
    disk.go.clear()
    started = time.monotonic()
    sizes = 0
    for k in range(10):
        frame = samples.frame(Eye.PRIMARY, k, 40)
        sizes += len(frame.image)
        writer.write_frame(frame)
        for _ in range(20):
            writer.write_pose(samples.pose(k))
    assert time.monotonic() - started < 1
    assert sizes < 50_000
    health = writer.health
    assert health.dropped_others > 0
    assert health.dropped_images == 0
    assert 0.5 < health.queue_fill <= 1
    disk.go.set()
    writer.close()
    recording = Recording(tmp_path)
    assert [f.sequence for f in recording.frames(Eye.PRIMARY)] == list(range(10))
    assert len(list(recording.poses())) + health.dropped_others == 200


def test_drops_are_logged(tmp_path: Path) -> None:
    disk = SlowDisk()
    settings = samples.config(chunk_bytes=1024, flush_s=0.05)
    writer = RecordingWriter(tmp_path, settings, queue_bytes=5_000, write=disk)
    time.sleep(0.1)
    disk.go.clear()
    for k in range(50):
        writer.write_pose(samples.pose(k))
    disk.go.set()
    until(lambda: any("not recorded" in text for text in logged(tmp_path)))
    writer.close()


def test_lossless_mode_loses_nothing_with_a_slow_disk(tmp_path: Path) -> None:
    def slow(fd: int, data: bytes) -> int:
        time.sleep(0.001)
        return os.write(fd, data)

    settings = samples.config(chunk_bytes=1024)
    with RecordingWriter(
        tmp_path, settings, lossless=True, queue_bytes=20_000, write=slow
    ) as writer:
        for k in range(30):
            writer.write_frame(samples.frame(Eye.PRIMARY, k))
            writer.write_pose(samples.pose(k))
    health = writer.close()
    assert (health.dropped_images, health.dropped_others, health.unwritable) == (0, 0, 0)
    recording = Recording(tmp_path)
    assert list(recording.frames(Eye.PRIMARY)) == [samples.frame(Eye.PRIMARY, k) for k in range(30)]
    assert len(list(recording.poses())) == 30
    with pytest.raises(RecordingError, match="closed"):
        writer.write_pose(samples.pose())


def test_marked_moments_are_read_back_with_their_times(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path, samples.config()) as writer:
        writer.write_event(samples.T0_NS + 5, "tram crosses")
        writer.write_event(samples.T0_NS + 9, "")
    events = list(Recording(tmp_path).events())
    assert events == [(samples.T0_NS + 5, "tram crosses"), (samples.T0_NS + 9, "")]


def test_the_drive_being_recorded_can_be_protected_and_released(tmp_path: Path) -> None:
    drive = tmp_path / "drive"
    with RecordingWriter(drive, samples.config(flush_s=0.05)) as writer:
        assert not writer.health.kept
        writer.keep(True)
        until(lambda: writer.health.kept)
        assert is_kept(drive)
        writer.keep(False)
        until(lambda: not writer.health.kept)
        assert not is_kept(drive)
        # as `calm-edge keep` does, in another process
        set_kept(drive, True)
        until(lambda: writer.health.kept)
    assert logged(drive) == [
        "the drive is protected from removal",
        "the drive is no longer protected from removal",
    ]


def test_a_drive_that_cannot_be_protected_says_so_and_loses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(drive: Path, kept: bool) -> None:
        raise RecordingError(f"{drive}: cannot be written (Read-only file system)")

    monkeypatch.setattr(writer_module, "set_kept", refuse)
    with RecordingWriter(tmp_path, samples.config()) as writer:
        writer.keep(True)
    assert not writer.health.kept and writer.health.unwritable == 0
    (line,) = logged(tmp_path)
    assert line.startswith("cannot be protected: ") and "Read-only" in line
