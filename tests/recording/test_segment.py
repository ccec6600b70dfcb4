"""A segment is a .part file until finished, and loses nothing when the disk fails."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from calm_edge.recording import RecordingError, schema
from calm_edge.recording.scan import scan
from calm_edge.recording.segment import (
    Segment,
    Stamped,
    missing_segments,
    recording_files,
    segment_files,
)


def stamped(k: int, size: int = 1000) -> Stamped:
    return Stamped(schema.LogMessage(schema.POSE_LIVE, k, bytes([k % 256]) * size), k, k)


def test_the_final_name_appears_only_when_finished(tmp_path: Path) -> None:
    segment = Segment(tmp_path, 3, 4096, {"a": {"b": "c"}})
    segment.write(stamped(1))
    assert [p.name for p in tmp_path.iterdir()] == ["0003.mcap.part"]
    assert segment.finish() == tmp_path / "0003.mcap"
    assert [p.name for p in tmp_path.iterdir()] == ["0003.mcap"]
    index = scan(tmp_path / "0003.mcap")
    assert (index.n_messages, index.cut, index.metadata[0].metadata) == (1, "", {"b": "c"})


def test_an_existing_part_file_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "0000.mcap.part").write_bytes(b"precious")
    with pytest.raises(FileExistsError):
        Segment(tmp_path, 0, 4096, {})
    assert (tmp_path / "0000.mcap.part").read_bytes() == b"precious"


@pytest.mark.parametrize("room", [30_000, 33_333, 41_234])
def test_abandon_returns_unwritten_messages_and_leaves_a_valid_file(
    tmp_path: Path, room: int
) -> None:
    left = room

    def write(fd: int, data: bytes) -> int:
        nonlocal left
        if left == 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        n = os.write(fd, data[: min(left, 700)])
        left -= n
        return n

    segment = Segment(tmp_path, 0, 4096, {}, write)
    written = 0
    with pytest.raises(OSError, match="No space"):
        for k in range(200):
            written += 1
            segment.write(stamped(k))
    back = segment.abandon()
    index = scan(tmp_path / "0000.mcap.part")
    assert not index.damaged
    assert index.cut == "never finished"
    kept = index.n_messages
    assert kept > 0
    assert [log_ns for _, log_ns, _ in back] == list(range(kept, written))


def test_files_are_sorted_by_number(tmp_path: Path) -> None:
    for name in ("10000.mcap", "0002.mcap.part", "0001.mcap", "notes.txt", "x.mcap"):
        (tmp_path / name).touch()
    assert [p.name for p in segment_files(tmp_path)] == [
        "0001.mcap",
        "0002.mcap.part",
        "10000.mcap",
    ]
    with pytest.raises(RecordingError):
        segment_files(tmp_path / "missing")


def test_numbers_left_out_are_missing_segments(tmp_path: Path) -> None:
    names = ["0000.mcap", "0001.mcap", "0003.mcap", "0007.mcap.part"]
    first, run = missing_segments([tmp_path / name for name in names])
    assert first.startswith(f"{tmp_path}/0002.mcap: missing")
    assert run.startswith(f"{tmp_path}/0004.mcap to 0006.mcap: missing")
    assert missing_segments([tmp_path / name for name in names[:2]]) == []
    assert "0000.mcap: missing" in missing_segments([tmp_path / "0001.mcap"])[0]


def test_a_folder_of_pictures_is_to_be_recorded(tmp_path: Path) -> None:
    (tmp_path / "cam0").mkdir()
    with pytest.raises(RecordingError, match="record --sequence"):
        recording_files(tmp_path)
