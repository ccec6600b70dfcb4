"""Names of drives, the mark to keep one, and the order in which segments are removed."""

from __future__ import annotations

from pathlib import Path

import pytest

from calm_edge.recording import RecordingError, retention
from calm_edge.recording.retention import (
    drives,
    is_kept,
    new_drive,
    remove_oldest,
    set_kept,
)


def filled(root: Path, segments: int) -> Path:
    drive = new_drive(root)
    for k in range(segments):
        (drive / f"{k:04d}.mcap").write_bytes(b"x")
    return drive


def test_names_count_up_over_boots_and_removals(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = new_drive(tmp_path / "root")
    assert first.is_dir() and first.name.startswith("000001-")
    monkeypatch.setattr(retention, "boot_id", lambda: "0a1b2c3d-4e5f")
    second = new_drive(tmp_path / "root")
    assert second.name == "000002-0a1b2c3d"
    first.rmdir()
    assert new_drive(tmp_path / "root").name == "000003-0a1b2c3d"
    (tmp_path / "root" / "1000000-0a1b2c3d").mkdir()
    assert [p.name[:7] for p in drives(tmp_path / "root")] == ["000002-", "000003-", "1000000"]


def test_a_root_that_cannot_be_created_raises_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(RecordingError, match="cannot be written"):
        new_drive(tmp_path / "file")


def test_the_oldest_is_removed_first_and_kept_or_foreign_files_stay(tmp_path: Path) -> None:
    old, kept, mine, present = (filled(tmp_path, 2) for _ in range(4))
    set_kept(kept, True)
    (old / "record_trajectory.tum").touch()
    (mine / "notes.txt").write_text("precious")
    stranger = tmp_path / "holiday"
    stranger.mkdir()
    (stranger / "0000.mcap").touch()
    gone = []
    while (removed := remove_oldest(tmp_path, present)) is not None:
        gone.append(removed.path)
        assert removed.size == 1
    assert gone == [*(old / n for n in ("0000.mcap", "0001.mcap")),
                    *(mine / n for n in ("0000.mcap", "0001.mcap")),
                    present / "0000.mcap"]  # fmt: skip
    assert not old.exists()
    assert [p.name for p in mine.iterdir()] == ["notes.txt"]
    assert sorted(p.name for p in kept.iterdir()) == ["0000.mcap", "0001.mcap", "KEEP"]
    assert [p.name for p in present.iterdir()] == ["0001.mcap"]
    assert (stranger / "0000.mcap").exists()
    set_kept(kept, False)
    assert remove_oldest(tmp_path, present) == (kept / "0000.mcap", 1)


def test_a_drive_marked_to_keep_while_recorded_loses_nothing(tmp_path: Path) -> None:
    present = filled(tmp_path, 3)
    set_kept(present, True)
    assert remove_oldest(tmp_path, present) is None
    assert is_kept(present)


def test_a_drive_that_cannot_be_removed_is_skipped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stuck, loose, present = (filled(tmp_path, 1) for _ in range(3))
    unlink = Path.unlink

    def failing(path: Path, missing_ok: bool = False) -> None:
        if path.parent == stuck:
            raise OSError(30, "Read-only file system")
        unlink(path, missing_ok)

    monkeypatch.setattr(Path, "unlink", failing)
    assert remove_oldest(tmp_path, present) == (loose / "0000.mcap", 1)
    assert remove_oldest(tmp_path, present) is None


def test_only_a_recording_can_be_marked_to_keep(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="holds no recording"):
        set_kept(tmp_path, True)
    with pytest.raises(RecordingError, match="holds no recording"):
        set_kept(tmp_path / "none", True)
