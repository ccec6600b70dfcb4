"""Recovered copies hold exactly the intact messages of the source."""

from __future__ import annotations

import os
import random
import shutil
from pathlib import Path

import pytest
from mcap.reader import make_reader

from calm_edge.config import RecordingConfig
from calm_edge.recording import RecordingError, recovery
from calm_edge.recording.chain import SegmentChain
from calm_edge.recording.reader import Recording
from calm_edge.recording.recovery import Outcome, default_target, recover, validate
from calm_edge.recording.scan import scan
from calm_edge.recording.schema import END_KEY, END_METADATA, SESSION_METADATA, frame_message
from calm_edge.recording.segment import Segment
from device.frame import Eye
from tests.recording import samples

N = 12
SESSION = {SESSION_METADATA: {END_KEY: "marked"}}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return samples.small_recording(tmp_path_factory.mktemp("recording") / "rec", N)


def test_an_intact_recording_is_valid_and_copies_without_loss(folder: Path, tmp_path: Path) -> None:
    report = validate(folder)
    assert (report.outcome, report.losses) == (Outcome.ALL, ())
    assert report.messages["/primary/image"] == N
    copied = recover(folder, tmp_path / "copy")
    assert copied.outcome == Outcome.ALL
    assert copied.messages == report.messages
    assert copied.files == (tmp_path / "copy" / "0000.mcap",)
    assert all(
        map(samples.same, Recording(tmp_path / "copy").updates(), Recording(folder).updates())
    )


def test_truncated_files_are_recovered_to_valid_mcap(folder: Path, tmp_path: Path) -> None:
    whole = (folder / "0000.mcap").read_bytes()
    rng = random.Random(5)
    for i in range(8):
        source, target = tmp_path / f"{i}.mcap.part", tmp_path / f"{i}-recovered.mcap"
        cut = whole[: rng.randrange(30_000, len(whole) - 2000)]
        source.write_bytes(cut)
        report = recover(source, target)
        assert report.outcome == Outcome.WITH_LOSS == 3
        assert any(str(source) in line for line in report.losses)
        assert source.read_bytes() == cut
        with target.open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            assert sum(1 for _ in reader.iter_messages()) == sum(report.messages.values()) > 0
        before, after = Recording(source), Recording(target)
        assert after.losses == []
        assert list(before.frames()) == list(after.frames())
        assert before.config == after.config
        assert before.metadata == after.metadata


def test_a_folder_is_recovered_segment_by_segment(folder: Path, tmp_path: Path) -> None:
    source, whole = tmp_path / "rec", (folder / "0000.mcap").read_bytes()
    source.mkdir()
    (source / "0000.mcap").write_bytes(whole)
    (source / "0001.mcap.part").write_bytes(whole[: len(whole) // 2])
    (source / "0002.mcap.part").write_bytes(b"")
    report = recover(source, tmp_path / "out")
    assert report.outcome == Outcome.WITH_LOSS
    assert [p.name for p in report.files] == ["0000.mcap", "0001.mcap"]
    assert sum("0002.mcap.part" in line for line in report.losses) == 1
    assert len(list(Recording(tmp_path / "out").frames(Eye.PRIMARY))) > N


def test_existing_targets_are_not_overwritten(folder: Path, tmp_path: Path) -> None:
    target = tmp_path / "target.mcap"
    target.write_bytes(b"precious")
    with pytest.raises(RecordingError, match="exists already"):
        recover(folder / "0000.mcap", target)
    assert target.read_bytes() == b"precious"
    (tmp_path / "other.mcap.part").write_bytes(b"precious")
    report = recover(folder / "0000.mcap", tmp_path / "other.mcap")
    assert report.outcome == Outcome.FAILED
    assert (tmp_path / "other.mcap.part").read_bytes() == b"precious"


def test_unreadable_sources_fail_in_one_line(folder: Path, tmp_path: Path) -> None:
    empty = tmp_path / "empty.mcap"
    empty.touch()
    header = tmp_path / "header.mcap"
    header.write_bytes((folder / "0000.mcap").read_bytes()[:60])
    for source in (empty, header, tmp_path / "missing"):
        report = recover(source, tmp_path / "out.mcap")
        assert report.outcome == Outcome.FAILED
        assert report.losses
        assert not (tmp_path / "out.mcap").exists()
    assert validate(empty).outcome == Outcome.FAILED
    assert validate(tmp_path / "missing").outcome == Outcome.FAILED


def test_validate_detects_a_single_flipped_bit(folder: Path, tmp_path: Path) -> None:
    copy = tmp_path / "0000.mcap"
    shutil.copy(folder / "0000.mcap", copy)
    data = bytearray(copy.read_bytes())
    data[data.index(samples.jpeg(10)) + 50] ^= 4
    copy.write_bytes(data)
    report = validate(copy)
    assert report.outcome == Outcome.WITH_LOSS
    assert report.messages["/primary/image"] < N
    assert recover(copy, tmp_path / "mended.mcap").messages == report.messages


def test_a_copy_that_reads_back_differently_is_removed(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = recovery._write

    def lying(index: object, writer: object) -> None:
        index.rows.popitem()  # type: ignore[attr-defined]
        real(index, writer)  # type: ignore[arg-type]
        index.rows.clear()  # type: ignore[attr-defined]

    monkeypatch.setattr(recovery, "_write", lying)
    report = recover(folder / "0000.mcap", tmp_path / "copy.mcap")
    assert report.outcome == Outcome.FAILED
    assert "reads back differently" in report.losses[0]
    assert list(tmp_path.iterdir()) == []


def test_the_default_target_is_beside_the_source_and_not_a_segment(
    folder: Path, tmp_path: Path
) -> None:
    source = tmp_path / "rec"
    shutil.copytree(folder, source)
    part = source / "0001.mcap.part"
    part.write_bytes((folder / "0000.mcap").read_bytes()[:50_000])
    assert default_target(source) == tmp_path / "rec-recovered"
    assert default_target(part) == source / "0001-recovered.mcap"
    before = [f.sequence for f in Recording(source).frames(Eye.PRIMARY)]
    recover(part, default_target(part))
    assert [f.sequence for f in Recording(source).frames(Eye.PRIMARY)] == before


def test_a_missing_segment_is_a_loss(folder: Path, tmp_path: Path) -> None:
    source = tmp_path / "rec"
    source.mkdir()
    for name in ("0000.mcap", "0002.mcap"):
        shutil.copy(folder / "0000.mcap", source / name)
    assert "0001.mcap: missing" in Recording(source).losses[0]
    for report in (validate(source), recover(source, tmp_path / "copy")):
        assert report.outcome == Outcome.WITH_LOSS and "0001.mcap: missing" in report.losses[0]
    assert Recording(source / "0002.mcap").losses == []


def _in_segments(folder: Path, n: int) -> Path:
    """Record a frame in each of n segments."""
    chain = SegmentChain(folder, RecordingConfig(), SESSION, lambda: 0, os.write, print)
    folder.mkdir()
    for k in range(n):
        chain.open()
        chain.write([frame_message(samples.frame(Eye.PRIMARY, k))], k)
        if k == n - 1:
            chain.write_metadata(END_METADATA, {"segments": str(n)})
        chain.finish()
    return folder


def test_missing_last_segments_are_a_loss(tmp_path: Path) -> None:
    source = _in_segments(tmp_path / "rec", 3)
    assert Recording(source).losses == []
    assert validate(source).outcome == recover(source, tmp_path / "whole").outcome == Outcome.ALL
    assert validate(tmp_path / "whole").outcome == Outcome.ALL
    (source / "0002.mcap").unlink()
    reports = validate(source), recover(source, tmp_path / "copy"), validate(tmp_path / "copy")
    for losses in (Recording(source).losses, *(report.losses for report in reports)):
        assert len(losses) == 1 and "0001.mcap: the end of the recording is not in it" in losses[0]
    assert all(report.outcome == Outcome.WITH_LOSS for report in reports)
    assert Recording(source / "0001.mcap").losses == []


def test_a_writer_marks_the_end_and_earlier_recordings_lack_no_end(
    folder: Path, tmp_path: Path
) -> None:
    index = scan(folder / "0000.mcap")
    assert index.metadata_of(END_METADATA) == {"segments": "1"}
    index.metadata = [m for m in index.metadata if m.name != END_METADATA]
    assert index.missing_end()
    for metadata in index.metadata:
        metadata.metadata.pop(END_KEY, None)
    assert index.missing_end() == []


def test_an_intact_segment_without_messages_is_copied(tmp_path: Path) -> None:
    source = _in_segments(tmp_path / "rec", 2)
    for number in (1, 2):
        (source / f"{number:04d}.mcap").unlink(missing_ok=True)
        end = {END_METADATA: {"segments": "3"}} if number == 2 else {}
        Segment(source, number, 8192, {**SESSION, **end}).finish()
    report = recover(source, tmp_path / "copy")
    assert (report.outcome, report.losses) == (Outcome.ALL, ())
    assert [file.name for file in report.files] == ["0000.mcap", "0001.mcap", "0002.mcap"]
    assert validate(tmp_path / "copy").outcome == Outcome.ALL
