import numpy as np
import pytest

from bench.model import depth
from bench.model.depth_scores import most_confident, relative_error, score


def test_relative_error_and_share_within_five_percent():
    error = relative_error(np.array([10.4, 12.0, 9.0]), np.full(3, 10.0))
    made = score(error, np.ones(3))
    assert made.abs_rel == pytest.approx((0.04 + 0.2 + 0.1) / 3)
    assert made.close == pytest.approx(1 / 3)


def test_confidence_in_the_order_of_the_error_has_no_area_and_against_it_the_most():
    error = np.random.default_rng(0).exponential(0.1, 2000)
    best, none, worst = (score(error, c).ause for c in (-error, np.zeros(2000), error))
    assert best == pytest.approx(0, abs=1e-12)
    assert 0.2 < none < worst


def test_the_most_confident_are_taken_from_the_known():
    known = np.array([True, False, True, True])
    chosen = most_confident(known, np.array([0.1, 0.9, 0.5, 0.7]), 2)
    assert chosen.tolist() == [False, False, True, True]
    assert most_confident(known, np.ones(4), 9).tolist() == known.tolist()


def scored(ours_error):
    rng, out = np.random.default_rng(1), []
    for drive in ("a", "b", "c"):
        for place in range(2):
            true_z = rng.uniform(5, 30, 400)
            off = np.abs(rng.normal(1, 0.2, 400))
            sparse = np.where(rng.random(400) < 0.5, 0.0, true_z * (1 + 0.1 * off))
            dense = true_z * (1 + ours_error * off)
            made = {"ours": (dense, 1 / off), "SGBM": (sparse, (sparse > 0) * 1.0)}
            out += depth.compared(drive, place, true_z, made)
    return out


def test_half_the_error_meets_the_requirement_and_the_same_error_does_not():
    kept = {c.what: c.passed for c in depth.table(scored(0.05), (), False).checks}
    assert all(kept.values()) and len(kept) == 3
    same = {c.what: c.passed for c in depth.table(scored(0.1), (), False).checks}
    assert not same["abs-rel where both have depth"]


def test_coverage_counts_and_equal_share_is_of_the_sparsest():
    ours, rival = scored(0.05)[:2]
    assert ours.coverage == 1.0 and 0.4 < rival.coverage < 0.6
    # the most confident of ours are its best
    assert ours.equal.abs_rel < ours.own.abs_rel
