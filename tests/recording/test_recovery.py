"""Recovered copies hold exactly the intact messages of the source."""

from __future__ import annotations

import random
import shutil
from pathlib import Path

import pytest
from mcap.reader import make_reader

from calm_edge.recording import RecordingError, recovery
from calm_edge.recording.reader import Recording
from calm_edge.recording.recovery import Outcome, default_target, recover, validate
from device.frame import Eye
from tests.recording import samples

N = 12


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
