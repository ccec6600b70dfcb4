"""Table of the rendered drives."""

import numpy as np
import pytest

from bench.accuracy import command
from bench.accuracy.drives import CONDITIONS, SEEDS, TRACKS, rendered

DRIVES = [(track, seed) for track in TRACKS for seed in SEEDS]


def _errors(factor):
    return {
        c: {drive: factor * 0.01 * (k + 1) for k, drive in enumerate(DRIVES)} for c in CONDITIONS
    }


def test_geometric_means_and_ratios_of_both_versions():
    table = command.rendered_table("c", {"against": _errors(1.0), "this": _errors(0.5)})
    assert [row[:2] for row in table.rows[:2]] == [("plain", "against"), ("plain", "this")]
    before, now = table.rows[:2]
    assert before[3] == pytest.approx(np.exp(np.mean(np.log([0.01 * k for k in range(1, 7)]))))
    assert now[3] == pytest.approx(before[3] / 2) and before[7] is None
    assert now[7:] == pytest.approx((0.5, 0.5, 0.5))
    assert [check.measured for check in table.checks] == [0.005] * 4


def test_a_failed_drive_is_counted_and_misses_the_requirement():
    errors = _errors(1.0)
    errors["plain"][DRIVES[0]] = None
    table = command.rendered_table("c", {"this": errors})
    assert table.rows[0][6] == 1
    assert [check.passed for check in table.checks] == [False, True, True, True]


def test_each_condition_is_a_drive_of_its_own(monkeypatch):
    names = {rendered(c, track, seed).name for c in CONDITIONS for track, seed in DRIVES}
    assert len(names) == len(CONDITIONS) * len(DRIVES)
