"""Table of errors over their sigmas."""

import numpy as np
import pytest

from bench import honesty
from bench.outcome import Outcome
from bench.relative_poses import Stretches


def _stretches(n, sigma, length):
    rng = np.random.default_rng(n)
    table = np.tile([sigma] * 3 + [0.001] * 3, (n, 1))
    return Stretches(rng.normal(size=(n, 6)) * table, table, np.full(n, length))


def _drive(yaw_deg=30.0, focal_sigma=0.01):
    live = {"1 s": _stretches(200, 0.05, 10.0), "100 m": _stretches(20, 0.5, 100.0)}
    focal = {"focal_error": (0.01, -0.01), "focal_sigma": (focal_sigma, focal_sigma)}
    scale = {"scale": 1.005, "scale_sigma": 0.01}
    return Outcome("d", 1.0, yaw_deg, 0.2, 0.1, **scale, **focal, live=live, final=live)


def test_every_quantity_has_a_row_and_what_is_asked_of_it():
    table = honesty.table("this", "bench honesty", [_drive(), _drive()])
    names = [row[0] for row in table.rows]
    assert names[:3] == ["focal, primary", "focal, assistant", "scale of a drive"]
    for which in ("live", "final"):
        for length in ("1 s", "100 m"):
            for what in ("position", "rotation"):
                assert f"{which} pose over {length}, {what}" in names
    assert len(table.checks) == 3 * len(names) + 3


def test_poses_are_in_percent_of_the_distance_and_degrees():
    rows = {row[0]: row for row in honesty.table("this", "", [_drive()]).rows}
    position, rotation = (rows[f"live pose over 1 s, {what}"] for what in ("position", "rotation"))
    assert position[1:3] == (600, pytest.approx(1.0, abs=0.1))
    assert position[-1] == f"{100 * 0.05 * 3**0.5 / 10:.3g} % of the distance"
    assert rotation[-1] == f"{np.degrees(0.001 * 3**0.5):.3g} degrees"


def test_only_drives_that_turn_are_asked_for_narrow_sigmas():
    def narrow(found):
        return [c.passed for c in honesty.table("this", "", found).checks if "median" in c.what]

    straight = _drive(1.0, 0.2)
    assert narrow([_drive(), straight, straight]) == [True, True, True]
    assert narrow([_drive(focal_sigma=0.04)]) == [False, False, True]


def test_drives_without_a_result_are_no_errors():
    failed = Outcome("d", 1.0, 30.0, failed="too dark")
    table = honesty.table("this", "", [failed])
    assert [row[1] for row in table.rows[:3]] == [0, 0, 0]
    assert not any(check.passed for check in table.checks)
