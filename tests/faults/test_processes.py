"""The real command, killed and stopped once; the fault table does it often."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.faults import process_rows as rows
from tests.replay.small_drive import write_drive


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_drive(tmp_path_factory.mktemp("processes") / "sequence", 90)


def test_kill_9_loses_at_most_1_5_s_and_an_independent_reader_agrees(
    drive: Path, tmp_path: Path
) -> None:
    row = rows.kill_9(drive, tmp_path, times=1, longest_s=4.0)
    assert row.kept, row


def test_sigterm_leaves_a_complete_recording_with_unchanged_jpegs(
    drive: Path, tmp_path: Path
) -> None:
    row = rows.terminated(drive, tmp_path)
    assert row.kept, row
