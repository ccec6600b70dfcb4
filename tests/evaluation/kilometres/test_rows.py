import pytest

from calm_edge.evaluation.kilometres import part_rows, rows
from calm_edge.evaluation.kilometres.plan import ABLATIONS, ASYNC, HALVED, LOOPS, OPEN, OURS, SIM3
from calm_edge.evaluation.kilometres.rows import Results
from tests.evaluation.kilometres.measured import focals, measured

NAMES = ("03", "04", "05", "06", "07", "09")


def _results(*variants, setting="open", names=NAMES, **changes):
    """(variant, error) of each drive."""
    made = [
        measured(name, variant=variant, error=error, setting=setting, **changes)
        for name in names
        for variant, error in variants
    ]
    return Results(made, names)


@pytest.mark.parametrize(("ours", "kept"), [(4.0, [True, True]), (6.0, [False, True]),
                                            (7.0, [False, False])])  # fmt: skip
def test_promises_of_the_open_drives(ours, kept):
    table = rows.open_drives(_results(("ours", ours), ("sim3", 20.0), ("sl4", 90.0)), "x")
    assert [check.passed for check in table.checks] == kept
    assert len(table.rows) == len(NAMES) + 1
    assert table.rows[-1][3] == pytest.approx(ours)
    assert all(len(row) == len(table.columns) for row in table.rows)
    assert not any("not run" in note for note in table.notes)


def test_a_failure_is_counted_and_has_no_mean():
    table = rows.open_drives(_results(("ours", 4.0), ("sim3", 20.0), ("sl4", None)), "x")
    assert table.rows[0][-1] == "1 of 1" and table.rows[0][-4] is None
    assert table.rows[-1][-4] is None
    assert any(
        note.startswith("ours over SL(4)") and "failed 0 / 6" in note for note in table.notes
    )


def test_a_column_with_a_hole_has_no_mean():
    made = [measured(name, variant=v) for name in NAMES for v in ("ours", "sim3")]
    made[-1] = measured(NAMES[-1], variant="sim3", error=None)
    table = rows.open_drives(Results(made, NAMES), "x")
    at = table.columns.index("Sim(3) m")
    assert table.rows[-1][at] is None and table.rows[0][at] == 1.0


def test_a_few_runs_keep_no_promise():
    few = _results(("ours", 1.0), ("sim3", 20.0), ("sl4", 90.0), names=NAMES[:2])
    assert not rows.open_drives(few, "x").checks[0].passed


def test_only_drives_that_come_back_have_loops():
    both = [("ours", 4.0), ("sim3", 20.0)]
    made = _results(*both, setting=LOOPS.name, names=["05", "06", "07", "09"])
    table = rows.looped_drives(Results(made.runs(LOOPS, OURS) + made.runs(LOOPS, SIM3), NAMES), "x")
    assert [row[0] for row in table.rows] == ["05", "06", "07", "09", "mean"]
    assert not table.checks[0].passed
    assert any(note.startswith(f"not run ({LOOPS.name}): 05") for note in table.notes)


@pytest.mark.parametrize(("apart", "kept"), [(1.0, True), (1.09, True), (1.2, False)])
def test_out_of_step_is_measured_against_the_same_rate(apart, kept):
    made = [measured(name, setting=ASYNC.name, error=apart) for name in NAMES]
    made += [measured(name, setting=HALVED.name) for name in NAMES]
    made += [measured(name, error=0.1) for name in NAMES]
    table = rows.synchronisation(Results(made, NAMES), "x")
    assert table.checks[0].passed is kept
    assert table.rows[0][-1] == pytest.approx(apart)


@pytest.mark.parametrize(("error", "kept"), [(1.0, [True, True]), (2.0, [False, True]),
                                             (4.0, [False, False])])  # fmt: skip
def test_scale(error, kept):
    table = rows.scales(_results(("ours", error), ("sim3", 9.0)), "x")
    assert [check.passed for check in table.checks] == kept
    assert table.rows[-1][3] == pytest.approx(error / 10)


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


def test_pairs_are_those_that_both_ran():
    made = [measured("04", seed=1), measured("04", seed=2), measured("04", variant="sim3", error=4)]
    ratio = Results(made, ["04"]).against((OPEN, OURS), (OPEN, SIM3))
    assert ratio is not None and ratio.pairs == 1 and ratio.ratio == pytest.approx(0.25)
