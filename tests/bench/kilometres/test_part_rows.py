import pytest

from bench.kilometres import part_rows
from bench.kilometres.plan import ABLATIONS, ASYNC, HALVED, PAPER_SEARCH
from bench.kilometres.rows import Results
from tests.bench.kilometres.measured import focals, measured

NAMES = ("03", "04", "05", "06", "07", "09")


@pytest.mark.parametrize(("apart", "kept"), [(1.0, True), (1.09, True), (1.2, False)])
def test_out_of_step_is_measured_against_the_same_rate(apart, kept):
    made = [measured(name, setting=ASYNC.name, error=apart) for name in NAMES]
    made += [measured(name, setting=HALVED.name) for name in NAMES]
    made += [measured(name, error=0.1) for name in NAMES]
    table = part_rows.synchronisation(Results(made, NAMES), "x")
    assert table.checks[0].passed is kept
    assert table.rows[0][-1] == pytest.approx(apart)


@pytest.mark.parametrize(("error", "kept"), [(1.0, [True, True]), (2.0, [False, True]),
                                             (4.0, [False, False])])  # fmt: skip
def test_scale(error, kept):
    made = [measured(name, error=error) for name in NAMES]
    made += [measured(name, variant="sim3", error=9.0) for name in NAMES]
    table = part_rows.scales(Results(made, NAMES), "x")
    assert [check.passed for check in table.checks] == kept
    assert [row[0] for row in table.rows[-2:]] == ["mean", "median"]
    assert [row[3] for row in table.rows[-2:]] == pytest.approx([error / 10] * 2)


def test_a_focal_that_was_not_observed_has_no_figure():
    of = [focals(5.0), focals(-7.0), focals(90.0, 0.2), focals(90.0, None)]
    made = [measured(name, focals=f) for name, f in zip(NAMES, of, strict=False)]
    table = part_rows.focal_table(Results(made, NAMES), "x")
    at = table.columns.index("ours px")
    assert [row[at] for row in table.rows] == pytest.approx([5.0, 7.0, None, None, 6.0])
    assert table.checks[0].passed and table.checks[0].measured == pytest.approx(6.0)
    assert any("2 of 4" in note for note in table.notes)


def test_a_part_that_shows_no_gain_is_explained():
    part, idle = ABLATIONS[0], ABLATIONS[3]
    made = [measured(name) for name in NAMES]
    made += [measured(name, variant=part.variant.name, error=1.5) for name in NAMES]
    for k, name in enumerate(NAMES):
        made.append(measured(name, variant=idle.variant.name, error=1.0 + 0.1 * (-1) ** k))
    table = part_rows.ablation(Results(made, NAMES), "x")
    by_title = {row[0]: row for row in table.rows}
    assert by_title[part.title][1] == pytest.approx(1.5)
    assert by_title[part.title][-1] == "worse" and by_title[idle.title][-1] == "tie"
    assert any(note.startswith(idle.title) and idle.why in note for note in table.notes)
    assert not any(note.startswith(part.title) for note in table.notes)
    assert sum("not run" in note for note in table.notes) == len(ABLATIONS) - 2


def test_both_searches_are_compared_by_the_runs_of_both():
    made = [measured(focals=focals(7.0)), measured("05", focals=focals(70.0))]
    made.append(measured(variant=PAPER_SEARCH.name, focals=focals(-14.0)))
    table = part_rows.ablation(Results(made, NAMES), "x")
    assert any("over 1 runs: 1.00 %" in n and "2.00 %" in n for n in table.notes)
