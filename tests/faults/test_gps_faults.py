"""Recording never waits for a GPS receiver."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.faults.gps_rows import KINDS, faulty_gps, no_receiver
from tests.replay.small_drive import write_drive

N = 24


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_drive(tmp_path_factory.mktemp("gps") / "sequence", N)


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_a_receiver_that_fails_is_named_and_loses_no_frame(
    drive: Path, tmp_path: Path, kind: str
) -> None:
    row = faulty_gps(drive, N, tmp_path, kind)
    assert row.kept, row


def test_a_missing_receiver_is_named_and_loses_no_frame(drive: Path, tmp_path: Path) -> None:
    row = no_receiver(drive, N, tmp_path)
    assert row.kept, row
