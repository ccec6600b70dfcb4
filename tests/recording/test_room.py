"""Floors, the recording rate and making room, on a fake disk."""

from __future__ import annotations

import os
from pathlib import Path
from types import SimpleNamespace

import pytest

from calm_edge.config import ConfigError, RecordingConfig
from calm_edge.recording import RecordingError
from calm_edge.recording.retention import new_drive, set_kept
from calm_edge.recording.room import HEADROOM_BYTES, Room, check_room

GIB = 1 << 30
CONFIG = RecordingConfig(keep_free_gib=2.0, keep_free_percent=1.0)


class Disk:
    """A fake statvfs: 100 GiB, of which each segment under `root` takes one; may be set to fail."""

    def __init__(self, root: Path, other_bytes: int) -> None:
        self.root, self.other_bytes, self.fails = root, other_bytes, False

    def __call__(self, path: object) -> SimpleNamespace:
        if self.fails:
            raise OSError(5, "Input/output error")
        used = sum(1 for _ in self.root.rglob("*.mcap")) * GIB + self.other_bytes
        return SimpleNamespace(f_blocks=100 * GIB, f_bavail=100 * GIB - used, f_frsize=1)


def with_drives(root: Path, *segments: int) -> list[Path]:
    made = []
    for n in segments:
        drive = new_drive(root)
        for k in range(n):
            (drive / f"{k:04d}.mcap").touch()
        made.append(drive)
    return made


def test_the_larger_floor_applies_and_time_left_uses_the_recent_rate(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "statvfs", Disk(tmp_path, 90 * GIB))
    room = Room(tmp_path, CONFIG)
    assert room.check(0.0, 0) and room.space.left_s is None
    assert room.space.floor_bytes == 2 * GIB
    room.check(10.0, 10 * 5_000_000)
    assert room.space.bytes_per_s == pytest.approx(5e6)
    assert room.space.left_s == pytest.approx(8 * GIB / 5e6)
    for second in range(11, 200):
        room.check(float(second), 50_000_000 + (second - 10) * 1_000_000)
    assert room.space.bytes_per_s == pytest.approx(1e6)
    percent = RecordingConfig(keep_free_gib=2.0, keep_free_percent=20.0)
    assert not Room(tmp_path, percent).check(0.0, 0)


def test_no_more_old_segments_are_removed_than_needed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    old, kept, present = with_drives(tmp_path, 2, 2, 1)
    set_kept(kept, True)
    disk = Disk(tmp_path, 94 * GIB)
    monkeypatch.setattr(os, "statvfs", disk)
    room = Room(present, CONFIG, tmp_path)
    assert room.check(0.0, 0)
    assert room.take_removed() == [old / "0000.mcap", old / "0001.mcap"]
    assert room.take_removed() == []
    disk.other_bytes = 96 * GIB
    assert not room.check(1.0, 0) and room.take_removed() == []
    assert sorted(p.name for p in kept.glob("*.mcap")) == ["0000.mcap", "0001.mcap"]


def test_a_disk_that_frees_space_late_loses_no_more_than_needed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    old, present = with_drives(tmp_path, 5, 1)
    for segment in old.iterdir():
        segment.write_bytes(b"\0" * HEADROOM_BYTES)
    full = SimpleNamespace(f_blocks=100 * GIB, f_bavail=2 * GIB - HEADROOM_BYTES // 2, f_frsize=1)
    monkeypatch.setattr(os, "statvfs", lambda _: full)
    room = Room(present, CONFIG, tmp_path)
    assert not room.check(0.0, 0)
    assert room.take_removed() == [old / "0000.mcap", old / "0001.mcap"]


def test_nothing_is_removed_if_disabled_or_if_free_space_is_unknown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, present = with_drives(tmp_path, 3, 1)
    disk = Disk(tmp_path, 95 * GIB)
    monkeypatch.setattr(os, "statvfs", disk)
    refusing = RecordingConfig(keep_free_gib=2.0, remove_old=False)
    assert not Room(present, refusing, tmp_path).check(0.0, 0)
    disk.fails = True
    room = Room(present, CONFIG, tmp_path)
    assert room.check(0.0, 0) and room.space.free_bytes is None and room.space.left_s is None
    assert not room.can_resume()
    assert len(list(tmp_path.rglob("*.mcap"))) == 4


def test_recording_resumes_above_the_floor_and_not_at_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk = Disk(tmp_path, 98 * GIB)
    monkeypatch.setattr(os, "statvfs", disk)
    room = Room(tmp_path, CONFIG)
    assert room.check(0.0, 0) and not room.can_resume()
    disk.other_bytes -= HEADROOM_BYTES
    assert room.can_resume()


def test_a_start_below_the_floor_raises_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "statvfs", Disk(tmp_path, 99 * GIB))
    with pytest.raises(RecordingError, match=r"1.00 GiB free, and 2.00 GiB") as caught:
        check_room(tmp_path / "not" / "there", CONFIG)
    assert "\n" not in str(caught.value)
    monkeypatch.setattr(os, "statvfs", Disk(tmp_path, 90 * GIB))
    check_room(tmp_path / "not" / "there", CONFIG)
    for wrong in (RecordingConfig(keep_free_gib=-1), RecordingConfig(keep_free_percent=100)):
        with pytest.raises(ConfigError, match="keep_free"):
            check_room(tmp_path, wrong)
