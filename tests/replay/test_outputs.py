"""Outputs of the real daemon."""

from __future__ import annotations

from pathlib import Path

from tests.faults.output_rows import bad_outputs


def test_in_lockstep_bad_outputs_lose_only_their_own_messages(
    small_drive: Path, tmp_path: Path
) -> None:
    row = bad_outputs(small_drive, 40, tmp_path, lockstep=True)
    assert row.kept, row
