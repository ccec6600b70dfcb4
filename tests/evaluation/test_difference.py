"""Figures of two estimates side by side, and their paths in one world."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calm_edge.evaluation.difference import overlay, plain, rows
from calm_edge.evaluation.estimate import Estimate
from calm_edge.evaluation.side import Figure, Side
from calm_edge.geometry import se3
from calm_edge.types import Metre
from tests.evaluation.worlds import curve, stamps

N = 60
MOVED = se3.exp(np.array([5.0, -2.0, 1.0, 0.1, 0.7, -0.2]))


def side(T: np.ndarray, metric: bool = True, later_ns: int = 0, **figures: Figure) -> Side:
    spacing, metre = (0.5, Metre(0.01)) if metric else (None, None)
    estimate = Estimate("r", stamps(len(T)), T, spacing_m=spacing, metre=metre)
    return Side(Path("drives/r"), "recording", estimate, stamps(len(T)) + later_ns, figures)


def test_paths_with_common_stamps_are_aligned_and_measured() -> None:
    bent = curve(N)
    bent[30:, :3, 3] += [0, 0.3, 0]
    found = overlay(side(curve(N)), side(MOVED @ bent))
    assert found.poses == N and found.scale == 1 and "SE(3)" in found.by
    assert 0.05 < found.rms < found.most < 0.2
    same = overlay(side(curve(N)), side(MOVED @ curve(N)))
    assert same.rms < 1e-9 and np.allclose(same.path_b, same.path_a)


def test_a_path_that_is_not_metric_is_stretched() -> None:
    small = curve(N)
    small[:, :3, 3] /= 4
    found = overlay(side(curve(N)), side(small, metric=False))
    assert found.scale == pytest.approx(4) and found.rms < 1e-9 and "Sim(3)" in found.by


def test_without_common_stamps_only_the_starts_meet() -> None:
    found = overlay(side(curve(N)), side(MOVED @ curve(N), later_ns=10**15))
    assert found.rms is None and found.poses == 0 and "no common stamps" in found.by
    assert np.allclose(found.path_b, found.path_a)
    empty = replace(side(curve(N)), t_ns=stamps(0))
    empty = replace(empty, estimate=Estimate("e", stamps(0), np.zeros((0, 4, 4))))
    assert "no path" in overlay(side(curve(N)), empty).by


def test_rows_are_grouped_and_have_differences_of_one_unit_only() -> None:
    a = side(
        curve(N),
        focal=Figure("kit", "focal", "px", 500.0),
        length=Figure("path", "length", "m", 100.0),
        pace=Figure("recording", "pace", "", "lockstep"),
    )
    b = side(
        curve(N),
        length=Figure("path", "length", "spacings", 200.0),
        focal=Figure("kit", "focal", "px", 505.0),
        pace=Figure("recording", "pace", "", "realtime"),
        sigma=Figure("kit", "sigma", "%", 1.5),
    )
    found = {row.key: row for row in rows(a, b)}
    assert [row.key for row in rows(a, b)] == ["focal", "sigma", "length", "pace"]
    assert found["focal"].cells() == ("focal", "500 px", "505 px", "+5 (+1 %)")
    assert found["length"].delta is None and found["length"].cells()[3] == "differs"
    assert found["pace"].cells()[3] == "differs"
    assert found["sigma"].cells() == ("sigma", "–", "1.5 %", "")
    json = plain(a, b)
    assert json["difference"] == {"focal": 5.0} and json["b"]["sigma"] == 1.5
    assert json["paths"]["common_keyframes"] == N
