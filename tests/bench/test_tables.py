import json

import numpy as np
import pytest

from bench import tables
from bench.__main__ import main
from bench.tables import Check, Table

ATE = Table(
    "10_ate",
    "ATE <km>",
    "python -m something",
    ("drive", "ours", "fails"),
    (("00", 1.25, None), ("01", np.float64(np.inf), True)),
    (Check("mean", "<= 1", 1.25, False),),
    ("five seeds",),
)


def test_a_table_comes_back_as_it_was_kept(tmp_path):
    tables.publish(ATE, tmp_path)
    (back,) = tables.kept(tmp_path)
    assert back.rows == (("00", 1.25, None), ("01", None, True))
    assert back.checks == ATE.checks and back.notes == ATE.notes and back.columns == ATE.columns


def test_the_page_shows_every_requirement_and_escapes(tmp_path):
    text = tables.render([ATE])
    assert "1 requirements, 0 met" in text
    assert "ATE &lt;km&gt;" in text and "<km>" not in text
    assert "python -m something" in text and "five seeds" in text


def test_a_broken_requirement_is_the_exit_code(tmp_path, capsys):
    tables.publish(ATE, tmp_path)
    assert main(["tables", "--out", str(tmp_path)]) == 1
    assert json.loads((tmp_path / "report.json").read_text())[0]["name"] == "10_ate"
    assert (tmp_path / "report.html").exists()
    (tmp_path / "tables" / "10_ate.json").unlink()
    assert main(["tables", "--out", str(tmp_path)]) == 0


def test_a_damaged_table_is_named(tmp_path):
    (tmp_path / "tables").mkdir()
    (tmp_path / "tables" / "x.json").write_text('{"rows": []}')
    with pytest.raises(tables.TableError, match=r"x\.json"):
        tables.kept(tmp_path)
