import numpy as np
import pytest

from calm_edge.correction.pool import BIAS_LOG_SIGMA, pooled

UNINFORMATIVE = np.full(2, np.inf)
ZERO = np.zeros(2)


def guesses(rng, n, *, bias=0.0, spread=0.03, alike=True):
    common = rng.standard_normal((n, 1))
    own = common if alike else rng.standard_normal((n, 2))
    return bias + spread * np.broadcast_to(own, (n, 2)) + 0.001 * rng.standard_normal((n, 2))


def test_without_an_informative_bank_the_guesses_are_averaged_and_keep_their_bias():
    rng = np.random.default_rng(0)
    found = pooled(guesses(rng, 40, bias=0.02), ZERO, UNINFORMATIVE)
    assert found.log_focal == pytest.approx([0.02, 0.02], abs=0.015)
    assert (found.log_sigma > BIAS_LOG_SIGMA - 1e-9).all()
    assert found.damping == 1.0


def test_an_informative_bank_overrides_the_guesses():
    rng = np.random.default_rng(1)
    found = pooled(guesses(rng, 40, bias=0.08), np.full(2, 0.0), np.full(2, 0.005))
    assert np.abs(found.log_focal).max() < 0.003
    assert (found.log_sigma < 0.006).all()


def test_the_bank_of_one_camera_corrects_the_other_if_guesses_are_correlated():
    rng = np.random.default_rng(2)
    sigma = np.array([np.inf, 0.005])
    alike = pooled(guesses(rng, 60, bias=0.08), ZERO, sigma)
    apart = pooled(guesses(rng, 60, bias=0.08, alike=False), ZERO, sigma)
    assert abs(alike.log_focal[0]) < 0.03 < abs(apart.log_focal[0])
    assert alike.log_sigma[0] < 0.6 * apart.log_sigma[0]


def test_the_sigma_matches_the_error():
    """Over many drives with biased guesses and noisy banks, errors have the estimated sigma."""
    rng = np.random.default_rng(3)
    ratio = []
    for _ in range(400):
        bias = BIAS_LOG_SIGMA * rng.standard_normal()
        sigma = np.array([0.04, 0.02])
        bank = sigma * rng.standard_normal(2)
        found = pooled(guesses(rng, 30, bias=bias), bank, sigma)
        ratio.append(found.log_focal / found.log_sigma)
    assert 0.8 < np.sqrt(np.mean(np.square(ratio))) < 1.2


def test_equal_guesses_do_not_divide_by_zero():
    found = pooled(np.zeros((3, 2)), ZERO, UNINFORMATIVE)
    assert np.isfinite(found.log_focal).all() and np.isfinite(found.log_sigma).all()
