"""What an interrupted `map` leaves is used for the same map only."""

from __future__ import annotations

from pathlib import Path

import pytest

from calm_edge.config import Config, merge
from calm_edge.offline.unfinished import Unfinished, UnfinishedError, plan
from calm_edge.recording.writer import RecordingWriter


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    RecordingWriter(tmp_path / "rec", Config()).close()
    return tmp_path / "rec"


def test_the_same_map_is_continued_and_another_refused(recording: Path, tmp_path: Path) -> None:
    folder, config = tmp_path / "map" / "unfinished", Config()
    Unfinished(folder, config, plan(recording, config))
    Unfinished(folder, config, plan(recording, config))
    other = merge(config, {"mapping": {"deform": False}})
    (recording / "0001.mcap").write_bytes((recording / "0000.mcap").read_bytes())
    for made_of in (plan(recording, config), plan(recording, other)):
        with pytest.raises(UnfinishedError, match=r"start anew with --force"):
            Unfinished(folder, config, made_of)


def test_nothing_is_solved_or_placed_at_first(recording: Path, tmp_path: Path) -> None:
    config = Config()
    with Unfinished(tmp_path / "work", config, plan(recording, config)) as work:
        assert work.solved() == {} and work.placed() is None
        work.remove()
    assert not (tmp_path / "work").exists()


def test_a_folder_that_cannot_be_made_is_named(recording: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(UnfinishedError, match=r"file/unfinished: cannot be written \(Not a dir"):
        Unfinished(tmp_path / "file" / "unfinished", Config(), plan(recording, Config()))


def test_a_folder_without_its_plan_is_refused(recording: Path, tmp_path: Path) -> None:
    (tmp_path / "work").mkdir()
    with pytest.raises(UnfinishedError, match=r"work: was made of another recording.*--force"):
        Unfinished(tmp_path / "work", Config(), plan(recording, Config()))
