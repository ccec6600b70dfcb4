"""Normalised errors: honest sigmas pass, too small and too large ones do not."""

import numpy as np
import pytest

from bench.normalised import NOT_REPORTED, normalised


def _passed(factor, n=4000):
    rng = np.random.default_rng(1)
    sigma = rng.uniform(0.01, 0.1, n)
    one = normalised("q", rng.normal(size=n) * sigma, factor * sigma)
    return [check.passed for check in one.checks()]


def test_honest_sigmas_meet_every_requirement():
    assert _passed(1.0) == [True, True, True]


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_too_small_and_too_large_sigmas_do_not(factor):
    assert not _passed(factor)[0]


def test_one_error_beyond_five_sigmas_is_too_many():
    error = np.concatenate([np.tile([1.0, -1.0], 500), [6.0]])
    checks = normalised("q", error, np.ones(1001)).checks()
    assert [check.passed for check in checks] == [True, True, False]
    assert checks[2].measured == pytest.approx(100 / 1001)


def test_what_is_not_reported_passes_for_nothing():
    one = normalised("q", [0.1, 0.2], [np.inf, np.nan])
    assert (one.missing, len(one.ratio), one.rms) == (2, 0, None)
    assert [check.measured for check in one.checks()] == [NOT_REPORTED] * 3
    assert not any(check.passed for check in (*one.checks(), one.narrow(2.0, "q")))
    assert NOT_REPORTED in one.row()


def test_wide_sigmas_do_not_pass_for_honest():
    wide = normalised("q", [0.01, -0.03], [0.03, 0.03])
    assert wide.claimed == pytest.approx(3.0)
    assert not wide.narrow(2.0, "q").passed
    assert normalised("q", [0.01, -0.03], [0.01, 0.02]).narrow(2.0, "q").passed
