"""Two minutes of simulated time; the fault table does four hours."""

from __future__ import annotations

from pathlib import Path

from tests.faults.endurance_rows import endurance
from tests.faults.table import table


def test_memory_stays_and_nothing_vanishes(tmp_path: Path) -> None:
    row = endurance(0.04, 20.0, tmp_path)
    assert row.kept, row


def test_the_table_names_each_fault_once(tmp_path: Path) -> None:
    assert len(table(tmp_path, tmp_path)) == 22
