"""What `validate` and `recover` print for programs."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from calm_edge.cli import main
from calm_edge.config import Config
from calm_edge.recording.writer import RecordingWriter


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    writer = RecordingWriter(tmp_path / "rec", Config())
    for k in range(20):
        writer.write_event(k, "x" * 5000)
    writer.close()
    return tmp_path / "rec"


def test_a_whole_recording_as_json(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["validate", str(recording), "--json"]) == 0
    table = json.loads(capsys.readouterr().out)
    assert table["outcome"] == "all" and table["losses"] == []
    assert table["messages"]["/event"] == 20 and table["files"] == [str(recording / "0000.mcap")]


def test_a_damaged_one_and_its_copy_as_json(
    recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = recording / "0000.mcap"
    data = file.read_bytes()
    file.write_bytes(data[: len(data) // 2])
    assert main(["validate", str(recording), "--json"]) == 3
    captured = capsys.readouterr()
    table = json.loads(captured.out)
    assert table["outcome"] == "with_loss" and "cut off within a record" in table["losses"][0]
    # all is in the object
    assert captured.err == ""
    copy = recording.parent / "copy"
    assert main(["recover", str(recording), "--out", str(copy), "--json"]) == 3
    table = json.loads(capsys.readouterr().out)
    assert table["outcome"] == "with_loss" and table["files"] == [str(copy / "0000.mcap")]


def test_nothing_to_read_as_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["validate", str(tmp_path / "none"), "--json"]) == 1
    table = json.loads(capsys.readouterr().out)
    assert table["outcome"] == "failed" and str(tmp_path / "none") in table["losses"][0]
