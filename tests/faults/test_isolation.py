"""Capture goes on while disk, estimator, tracker, serial line, page or an output fails."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from calm_edge.daemon import tracker_link
from tests.faults import isolation_rows as rows
from tests.faults.output_rows import bad_outputs
from tests.faults.row import Row
from tests.replay.small_drive import write_drive

N = 24


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_drive(tmp_path_factory.mktemp("isolation") / "sequence", N)


@pytest.mark.parametrize(
    "fault",
    [
        rows.blocking_disk_full_queue,
        rows.suspended_estimator,
        rows.suspended_tracker,
        rows.stalled_serial,
        rows.suspended_live_page,
        bad_outputs,
    ],
)
def test_capture_goes_on(
    drive: Path,
    tmp_path: Path,
    fault: Callable[[Path, int, Path], Row],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # the ring of frames for the tracker would hold so short a drive
    monkeypatch.setattr(tracker_link, "RING_SLOTS", 12)
    row = fault(drive, N, tmp_path)
    assert row.kept, row
