import pytest

from bench.kilometres import rows
from bench.kilometres.plan import LOOPS, OPEN, OURS, SIM3
from bench.kilometres.rows import Results
from tests.bench.kilometres.measured import measured

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
def test_requirements_of_the_open_drives(ours, kept):
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


def test_unlike_numbers_of_seeds_are_said():
    made = [measured("04", seed) for seed in (1, 2)]
    made += [measured("04", variant=variant) for variant in ("sim3", "sl4")]
    assert rows.open_drives(Results(made, ["04"]), "x").rows[0][2] == "2 / 1 / 1"


def test_a_few_runs_meet_no_requirement():
    few = _results(("ours", 1.0), ("sim3", 20.0), ("sl4", 90.0), names=NAMES[:2])
    assert not rows.open_drives(few, "x").checks[0].passed


def test_only_drives_that_come_back_have_loops():
    both = [("ours", 4.0), ("sim3", 20.0)]
    made = _results(*both, setting=LOOPS.name, names=["05", "06", "07", "09"])
    table = rows.looped_drives(Results(made.runs(LOOPS, OURS) + made.runs(LOOPS, SIM3), NAMES), "x")
    assert [row[0] for row in table.rows] == ["05", "06", "07", "09", "mean"]
    assert not table.checks[0].passed
    assert any(note.startswith(f"not run ({LOOPS.name}): 05") for note in table.notes)


def test_pairs_are_those_that_both_ran():
    made = [measured("04", seed=1), measured("04", seed=2), measured("04", variant="sim3", error=4)]
    ratio = Results(made, ["04"]).against((OPEN, OURS), (OPEN, SIM3))
    assert ratio is not None and ratio.pairs == 1 and ratio.ratio == pytest.approx(0.25)
