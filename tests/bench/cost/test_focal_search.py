from bench.__main__ import main
from bench.cost import focal_search
from bench.tables import kept


def test_turns_are_informative_and_their_sigma_is_about_right():
    motions, count, error, sigma, ratio, milliseconds = focal_search.row(("general",), 1)
    assert motions == "general" and count == "1 of 1"
    assert 0 < error < 0.1 and 0 < sigma < 0.1
    assert 0.05 < ratio < 3 and milliseconds > 0


def test_tangent_arcs_are_not_informative_and_have_no_figures():
    assert focal_search.row(("tangent",), 1)[1:5] == ("0 of 1", None, None, None)


def test_the_command_keeps_a_row_for_each_bank(tmp_path, monkeypatch):
    monkeypatch.setattr(focal_search, "BANKS", (("tangent",), ("straight",)))
    assert main(["cost.search", "--seeds", "1", "--out", str(tmp_path)]) == 0
    (table,) = kept(tmp_path)
    assert [cells[0] for cells in table.rows] == ["tangent", "straight"]
