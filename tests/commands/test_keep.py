"""What `keep` prints for programs."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from calm_edge.cli import main
from calm_edge.config import Config
from calm_edge.recording.retention import KEEP_FLAG
from calm_edge.recording.writer import RecordingWriter


def test_what_was_kept_or_released_as_json(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drive = tmp_path / "000001-abc"
    RecordingWriter(drive, Config()).close()
    for options, kept in (([], True), (["--release"], False)):
        assert main(["keep", str(drive), "--json", *options]) == 0
        table = json.loads(capsys.readouterr().out)
        assert table == {"recordings": [str(drive)], "kept": kept}
        assert (drive / KEEP_FLAG).exists() == kept
