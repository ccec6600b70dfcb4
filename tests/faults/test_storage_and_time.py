"""Faults of disks and clocks, and overheating, on a short drive."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.faults import storage_rows, time_rows
from tests.faults.row import Row
from tests.replay.small_drive import write_drive

N = 32


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_drive(tmp_path_factory.mktemp("faults") / "sequence", N)


@pytest.mark.parametrize(
    "fault",
    [
        storage_rows.full_disk,
        storage_rows.failing_disk,
        time_rows.wall_clock,
        time_rows.throttling,
    ],
)
def test_the_fault_row_passes(
    drive: Path, tmp_path: Path, fault: Callable[[Path, int, Path], Row]
) -> None:
    row = fault(drive, N, tmp_path)
    if row.skipped:
        pytest.skip(row.figure)
    assert row.kept, row


def test_stamps_that_go_backwards(drive: Path, tmp_path: Path) -> None:
    row = time_rows.wrong_stamps(drive, N, tmp_path, "backwards")
    assert row.kept, row
