"""Two minutes of simulated time; the fault table runs four hours."""

from __future__ import annotations

from pathlib import Path

from tests.faults.endurance_rows import endurance
from tests.faults.table import table


def test_memory_is_bounded_and_every_loss_is_counted(tmp_path: Path) -> None:
    row = endurance(0.04, 20.0, tmp_path)
    assert row.kept, row


def test_the_table_has_all_faults(tmp_path: Path) -> None:
    assert len(table(tmp_path, tmp_path)) == 28
