"""Losses of the recording on kill, full disk and failing disk."""

from __future__ import annotations

import errno
import os
import random
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from calm_edge.recording import RecordingError, schema
from calm_edge.recording.reader import Recording
from calm_edge.recording.recovery import Outcome, recover
from calm_edge.recording.writer import RecordingWriter
from device.frame import Eye
from tests.recording import samples

# the default floors are larger than the small disk
NO_FLOOR = {"keep_free_gib": 0.0, "keep_free_percent": 0.0}

CHILD = """
import sys, time
from pathlib import Path
from calm_edge.recording.writer import RecordingWriter
from device.frame import Eye, Frame
from tests.recording import samples
writer = RecordingWriter(Path(sys.argv[1]), samples.config())
jpegs = [samples.jpeg(k, 160) for k in range(4)]
update = samples.update()
print("ready", flush=True)
for k in range(10**6):
    now = time.monotonic_ns()
    for eye in Eye:
        writer.write_frame(Frame(eye, k, now, jpegs[k % 4]))
    pose = samples.pose()
    writer.write_pose(type(pose)(now, *[getattr(pose, f) for f in pose.__slots__[1:]]))
    time.sleep(0.02)
"""


def until(condition: Callable[[], bool], timeout_s: float = 8) -> None:
    end = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end, "never happened"
        time.sleep(0.02)


@pytest.mark.parametrize("alive_s", [1.3, 1.9, 2.6])
def test_kill_9_loses_at_most_a_second_and_a_half(tmp_path: Path, alive_s: float) -> None:
    folder = tmp_path / "rec"
    child = subprocess.Popen(
        [sys.executable, "-c", CHILD, str(folder)],
        stdout=subprocess.PIPE,
        cwd=Path(__file__).parents[2],
    )
    assert child.stdout is not None
    with child.stdout:
        assert child.stdout.readline() == b"ready\n"
        time.sleep(alive_s + random.uniform(0, 0.3))
        child.send_signal(signal.SIGKILL)
        killed_ns = time.monotonic_ns()
        child.wait()
    recording = Recording(folder)
    assert [p.name for p in folder.iterdir()] == ["0000.mcap.part"]
    assert any("never finished" in line or "cut" in line for line in recording.losses)
    jpegs = [samples.jpeg(k, 160) for k in range(4)]
    for eye in Eye:
        frames = list(recording.frames(eye))
        assert killed_ns - frames[-1].t_ns < 1.5e9
        assert [f.sequence for f in frames] == list(range(len(frames)))
        assert all(f.image == jpegs[f.sequence % 4] for f in frames)
    assert killed_ns - list(recording.poses())[-1].t_ns < 1.5e9
    assert recover(folder, tmp_path / "recovered").outcome == Outcome.WITH_LOSS
    assert Recording(tmp_path / "recovered").losses == []


class Disk:
    """A write() that fails once `room` bytes are written."""

    def __init__(self, room: int) -> None:
        self.room = room
        self.error = errno.ENOSPC

    def __call__(self, fd: int, data: bytes) -> int:
        if self.room <= 0:
            raise OSError(self.error, os.strerror(self.error))
        n = os.write(fd, data[: self.room])
        self.room -= n
        return n


@pytest.fixture(autouse=True)
def quick_retry(monkeypatch: pytest.MonkeyPatch) -> None:
    from calm_edge.recording import writer

    monkeypatch.setattr(writer, "RETRY_S", 0.05)


@pytest.mark.parametrize("room", [60_000, 100_001, 133_333])
@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EIO])
def test_a_full_or_failing_disk_is_reported_and_nothing_is_lost_within_the_queue(
    tmp_path: Path, room: int, code: int
) -> None:
    disk = Disk(room)
    disk.error = code
    settings = samples.config(chunk_bytes=8192, flush_s=0.05)
    writer = RecordingWriter(tmp_path, settings, write=disk)
    for k in range(30):
        writer.write_frame(samples.frame(Eye.PRIMARY, k))
        writer.write_pose(samples.pose(k))
    until(lambda: writer.health.error)
    assert os.strerror(code) in writer.health.error
    assert "\n" not in writer.health.error
    readable = list(Recording(tmp_path).frames(Eye.PRIMARY))
    assert readable == [samples.frame(Eye.PRIMARY, k) for k in range(len(readable))]
    disk.room = 10**9
    until(lambda: not writer.health.error)
    writer.write_frame(samples.frame(Eye.PRIMARY, 30))
    health = writer.close()
    assert (health.dropped_images, health.dropped_others, health.unwritable) == (0, 0, 0)
    recording = Recording(tmp_path)
    frames = list(recording.frames(Eye.PRIMARY))
    assert frames == [samples.frame(Eye.PRIMARY, k) for k in range(31)]
    assert [samples.same(p, samples.pose(k)) for k, p in enumerate(recording.poses())] == [
        True
    ] * 30
    assert sum(p.suffix == ".part" for p in tmp_path.iterdir()) == 1


def test_the_first_error_is_reported_if_files_cannot_be_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk = Disk(10**9)
    writer = RecordingWriter(tmp_path, samples.config(flush_s=0.05), write=disk)
    writer.write_frame(samples.frame(Eye.PRIMARY, 0))
    until(lambda: Recording(tmp_path).count("/primary/image") == 1)
    tries: list[Path] = []

    def stuck(path: Path, missing_ok: bool = False) -> None:
        tries.append(path)
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    with monkeypatch.context() as patch:
        patch.setattr(Path, "unlink", stuck)
        disk.room, disk.error = 0, errno.EIO
        errors = set()
        while len(tries) < 4:
            errors.add(writer.health.error)
            time.sleep(0.01)
        errors.add(writer.health.error)
    assert all(os.strerror(errno.EIO) in text for text in errors if text)
    disk.room = 10**9
    until(lambda: not writer.health.error)
    writer.write_frame(samples.frame(Eye.PRIMARY, 1))
    writer.close()
    assert [f.sequence for f in Recording(tmp_path).frames(Eye.PRIMARY)] == [0, 1]


def test_closing_on_a_full_disk_returns_and_counts_the_loss(tmp_path: Path) -> None:
    disk = Disk(60_000)
    writer = RecordingWriter(tmp_path, samples.config(chunk_bytes=8192), write=disk)
    for k in range(40):
        writer.write_frame(samples.frame(Eye.PRIMARY, k))
    until(lambda: writer.health.error)
    health = writer.close()
    kept = len(list(Recording(tmp_path).frames(Eye.PRIMARY)))
    # a clock message may be among the unwritten
    lost = health.dropped_images + health.unwritable
    assert 0 <= kept + lost - 40 <= 1
    assert 0 < kept < 40


def test_lossless_mode_raises_one_line_on_a_full_disk(tmp_path: Path) -> None:
    disk = Disk(60_000)
    settings = samples.config(chunk_bytes=8192)
    writer = RecordingWriter(tmp_path, settings, lossless=True, queue_bytes=20_000, write=disk)
    with pytest.raises(RecordingError, match="No space left"):
        for k in range(200):
            writer.write_frame(samples.frame(Eye.PRIMARY, k))
    writer.close()


def test_a_slow_sync_does_not_delay_writing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    go, real = threading.Event(), os.fdatasync

    def slow(fd: int) -> None:
        assert go.wait(20)
        real(fd)

    writer = RecordingWriter(tmp_path, samples.config(flush_s=0.05))
    monkeypatch.setattr(os, "fdatasync", slow)
    for k in range(5):
        writer.write_frame(samples.frame(Eye.PRIMARY, k))
        # what would be left after a kill
        until(lambda k=k: Recording(tmp_path).count("/primary/image") == k + 1)
    go.set()
    assert not writer.close().error
    assert Recording(tmp_path).losses == []


def test_a_sync_that_fails_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    writer = RecordingWriter(tmp_path, samples.config(flush_s=0.05))
    writer.write_frame(samples.frame(Eye.PRIMARY, 0))
    until(lambda: Recording(tmp_path).count("/primary/image") == 1)
    with monkeypatch.context() as patch:

        def failing(fd: int) -> None:
            raise OSError(errno.EIO, "Input/output error")

        patch.setattr(os, "fdatasync", failing)
        until(lambda: writer.health.error)
    until(lambda: not writer.health.error)
    writer.write_frame(samples.frame(Eye.PRIMARY, 1))
    writer.close()
    assert [f.sequence for f in Recording(tmp_path).frames(Eye.PRIMARY)] == [0, 1]


def test_an_error_in_the_writer_thread_is_reported_and_recording_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object) -> schema.LogMessage:
        raise ValueError("a bug")

    writer = RecordingWriter(tmp_path, samples.config(flush_s=0.05))
    writer.write_pose(samples.pose(0))
    until(lambda: len(list(Recording(tmp_path).poses())) == 1)
    with monkeypatch.context() as patch:
        patch.setattr(schema, "clock_message", broken)
        until(lambda: "a bug" in writer.health.error)
        writer.write_pose(samples.pose(1))
    until(lambda: not writer.health.error)
    writer.close()
    assert [p.epoch for p in Recording(tmp_path).poses()] == [0, 1]


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    mount = shutil.which("mount")
    folder = tmp_path / "disk"
    folder.mkdir()
    made = mount and subprocess.run(
        [mount, "-t", "tmpfs", "-o", "size=24m", "tmpfs", str(folder)], capture_output=True
    )
    if not made or made.returncode:
        pytest.skip("no tmpfs can be mounted here")
    yield folder
    subprocess.run(["umount", "-l", str(folder)], check=True)


def test_a_full_file_system_closes_the_segment_complete(small_disk: Path) -> None:
    writer = RecordingWriter(small_disk / "rec", samples.config(flush_s=0.02, **NO_FLOOR))
    image = samples.jpeg(0, 320)
    stop = threading.Event()
    k = 0
    while not writer.health.error and not stop.wait(0.002):
        frame = samples.frame(Eye.PRIMARY, 0)
        writer.write_frame(type(frame)(Eye.PRIMARY, k, k, image))
        k += 1
        assert k < 2000
    assert "No space left" in writer.health.error
    writer.close()
    recording = Recording(small_disk / "rec")
    (loss,) = recording.losses
    assert "the end of the recording is not in it" in loss
    assert recording.count("/primary/image") > 50
    assert shutil.disk_usage(small_disk).free > 4 << 20
