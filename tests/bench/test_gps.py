"""Simulated fixes: what is drawn, and that GPX brings it back."""

from __future__ import annotations

import argparse

import numpy as np

from bench import gps
from bench.gps import ORIGIN, aligned, simulated, through_gpx
from calm_edge.evaluation.estimate import Estimate
from calm_edge.evaluation.truth import Truth
from calm_edge.geometry import local_enu, se3
from calm_edge.types import Metre
from tests.evaluation.worlds import curve

OPTIONS = argparse.Namespace(noise_m=1.5, delay_s=0.3, gap_s=3.0, wrong=0.08)


def drive() -> tuple[Truth, Estimate]:
    """A drive of 40 s whose estimate is its truth."""
    T = curve(400)
    T = se3.inverse(T[0]) @ T
    t_ns = 1_700_000_000 * 10**9 + np.arange(len(T)) * 10**8
    return Truth(t_ns, T), Estimate("drive", t_ns, T, spacing_m=0.5, metre=Metre(0.01))


def test_fixes_have_the_noise_the_gap_and_the_wrong_ones_that_were_asked_for() -> None:
    truth, _ = drive()
    fixes = simulated(truth, OPTIONS, 0)
    seconds = (fixes.t_ns - truth.t_ns[0]) / 1e9
    assert 2.9 < np.diff(seconds).max() < 3.2 and 5 < fixes.wrong.sum() < 60
    true = se3.transform(fixes.T_enu_w, truth.T_w_c[:, :3, 3])
    late = np.stack(
        [np.interp(seconds - 0.3, np.arange(400) / 10, true[:, k]) for k in range(3)], 1
    )
    off = local_enu.enu(fixes.lla, ORIGIN) - late
    assert 1.2 < np.median(np.abs(off), axis=0).mean() / 0.6745 < 1.8
    assert np.linalg.norm(off[fixes.wrong, :2], axis=1).min() > 9
    read = through_gpx(fixes, 1.5)
    # GPX has microseconds
    assert np.abs(read.t_ns - fixes.t_ns).max() < 1000
    assert np.abs(local_enu.enu(read.lla, ORIGIN) - local_enu.enu(fixes.lla, ORIGIN)).max() < 0.001


def test_an_exact_path_meets_the_requirements_and_a_late_one_does_not() -> None:
    truth, estimate = drive()
    fixes = simulated(truth, OPTIONS, 1)
    row, checks = aligned(estimate, truth, fixes, "spacing", OPTIONS)
    assert len(row) == len(gps.COLUMNS) - 3 and all(check.passed for check in checks), checks
    _, checks = aligned(
        estimate, truth, fixes, "spacing", argparse.Namespace(**vars(OPTIONS) | {"delay_s": 1.0})
    )
    assert [check.passed for check in checks] == [False, True, True]
