"""The real command, killed, stopped and hung: once each, where the fault table does it often."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.faults import process_rows as rows
from tests.replay.small_drive import write_drive


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_drive(tmp_path_factory.mktemp("processes") / "sequence", 90)


def test_kill_9_costs_a_second_and_a_half_and_others_count_the_same(
    drive: Path, tmp_path: Path
) -> None:
    row = rows.kill_9(drive, tmp_path, times=1, longest_s=4.0)
    assert row.kept, row


def test_sigterm_leaves_a_whole_recording_of_the_cameras_own_bytes(
    drive: Path, tmp_path: Path
) -> None:
    row = rows.terminated(drive, tmp_path)
    assert row.kept, row
