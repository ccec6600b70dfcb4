"""Rows of the table of formats: what agrees, what does not, and what is not installed."""

from __future__ import annotations

from pathlib import Path

import pytest

from calm_edge.commands.export import FORMATS
from tests.interop import formats_in, formats_out
from tests.interop.format_row import Row, calm_edge
from tests.interop.formats import read, small_drive


@pytest.mark.parametrize("name", ["folders, jpg", "EuRoC", "Foxglove, JSON"])
def test_sources_are_read_back_with_their_stamps(name: str) -> None:
    (row,) = (row for row in formats_in.ROWS if row.name == name)
    _, reader, figures, agrees = read(row)
    assert agrees and reader == "mcap (Python)"
    assert "primary" in figures and "assistant" in figures and "0.000 ms off" in figures


def test_every_format_of_export_has_a_row_and_small_ones_agree(tmp_path: Path) -> None:
    rows = formats_out.rows(small_drive(tmp_path))
    named = [row.name.lower().replace(" ", "").replace(".json", "") for row in rows]
    assert all(any(name.startswith(each) for name in named) for each in FORMATS)
    for row in rows:
        if row.name in ("CSV", "GPX", "pictures"):
            assert read(row)[-1], row.name


def test_a_row_that_fails_is_no_agreement_and_an_absent_reader_is_named() -> None:
    def absent(folder: Path) -> None:
        raise ImportError("no", name="reader_of_others")

    def refused(folder: Path) -> None:
        calm_edge("export", folder / "none", "--to", "tum", "--out", folder / "out")

    skipped = read(Row("a", "b", absent))  # type: ignore[arg-type]
    assert skipped[-1] is None and "reader_of_others" in skipped[2]
    failed = read(Row("a", "b", refused))  # type: ignore[arg-type]
    assert failed[-1] is False and "none" in failed[2]
