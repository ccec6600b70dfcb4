"""Posterior of both focals from all sub-maps and both test banks (an extension of paper V-A).

A *guess* is the backbone's estimate of a focal in one sub-map. The focal is constant in a drive, so
the deviation of a guess from the median of all is an error to correct, even if the banks are
uninformative. The error common to all guesses is the backbone's bias, which the banks measure. As
one network estimates both cameras, its biases are taken to be as correlated as its guesses are over
the sub-maps: an informative bank of one camera thus corrects the other camera too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calm_edge.correction import damping
from calm_edge.types import Float

# Sigma of the bias in log focal: published models have an error of 3 to 6 % in the mean of a drive.
BIAS_LOG_SIGMA = 0.06
# With C sub-maps the sample correlation is multiplied by C / (C + this), as few are unreliable.
_SHRINKAGE_COUNT = 5
# Upper bound of the sample correlation.
_MAX_CORRELATION = 0.95
_MAD_TO_SIGMA = 1.4826
_MIN_SIGMA = 1e-4


@dataclass(frozen=True, slots=True)
class Pooled:
    """Posterior of both cameras: log_focal (2,) [log px], log_sigma (2,), common damping."""

    log_focal: Float
    log_sigma: Float
    damping: float


def pooled(guesses: Float, bank_log_focal: Float, bank_log_sigma: Float) -> Pooled:
    """Gaussian posterior of the log focals of both cameras.

    guesses: (C, 2) [log px], a row per sub-map, C >= 1; their medians are the prior, with their
    scatter and a correlated bias as covariance. bank_log_focal, bank_log_sigma: (2,) measurements
    of the banks, sigma inf for an uninformative one.
    """
    median = np.median(guesses, 0)
    deviation = guesses - median
    sigma = np.maximum(_MAD_TO_SIGMA * np.median(np.abs(deviation), 0), _MIN_SIGMA)
    n = len(guesses)
    correlation = _correlation(deviation)
    shape = np.array([[1.0, correlation], [correlation, 1.0]])
    prior = shape * (BIAS_LOG_SIGMA**2 + np.outer(sigma, sigma) / n)
    measured = np.where(np.isfinite(bank_log_sigma), bank_log_sigma, np.inf) ** -2.0
    covariance = np.linalg.inv(np.linalg.inv(prior) + np.diag(measured))
    step = covariance @ (measured * np.where(measured > 0, bank_log_focal - median, 0.0))
    return Pooled(median + step, np.sqrt(np.diag(covariance)), damping.from_guesses(n))


def _correlation(deviation: Float) -> float:
    """Correlation of the cameras' deviations (C, 2), shrunk towards zero for small C."""
    norm = float(np.sqrt((deviation**2).sum(0).prod()))
    if norm == 0:
        return 0.0
    sample = float(np.clip(float(deviation[:, 0] @ deviation[:, 1]) / norm, 0, _MAX_CORRELATION))
    return sample * len(deviation) / (len(deviation) + _SHRINKAGE_COUNT)
