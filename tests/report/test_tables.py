"""Tables of the report."""

from __future__ import annotations

import os
from pathlib import Path

from calm_edge.report.tables import durations, files, number, rows


def test_durations_are_sorted_summed_and_have_bars() -> None:
    table = durations({"depth": 90.0, "fusion <1>": 30.0}, "s")
    assert table.index("depth") < table.index("fusion &lt;1&gt;") < table.index("120 s")
    assert "width:100.0%" in table and "width:33.3%" in table
    assert number(10_225.4) == "10,225" and number(0.0052571) == "0.00526"


def test_links_are_relative_and_only_to_what_is_there(tmp_path: Path) -> None:
    folder = tmp_path / "rec 1"
    folder.mkdir()
    odd = folder / os.fsdecode(b"a\xff#.mcap")
    odd.write_bytes(b"12")
    table = files(tmp_path / "map" / "report.html", [odd, folder, tmp_path / "none"])
    assert 'href="../rec%201/a%FF%23.mcap"' in table and 'href="../rec%201"' in table
    assert "none" not in table and "folder" in table
    assert files(tmp_path / "report.html", []) == ""


def test_rows_have_a_head() -> None:
    assert rows(("a",), [("<b>",)]) == (
        "<table><tr><th>a</th></tr><tr><td>&lt;b&gt;</td></tr></table>"
    )
