"""What the banks of both eyes and all guesses together say of the focals (past paper V-A).

A drive has one focal an eye, so no guess knows better than all of them: a sub-map's own deviation
is error, whatever the bank can tell, and correcting it to the common focal is right from the second
sub-map on. What all guesses share is the backbone's bias, and the bank is there to find it. One
model looks through both eyes: how alike its guesses vary over the sub-maps is taken for how alike
its bias is, so a bank that turned out telling for one eye helps the other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calm_edge.correction import damping
from calm_edge.types import Float

# One sigma of log focal that all guesses of a drive have in common: published models err by 3 to
# 6 % on the mean of a drive.
BIAS_LOG_SIGMA = 0.06
# Pairs of guesses after which their correlation is half believed, and the most of it ever believed.
_HALF_BELIEVED = 5
_MOST_ALIKE = 0.95
_MAD_TO_SIGMA = 1.4826
_LEAST_SPREAD = 1e-4


@dataclass(frozen=True, slots=True)
class Pooled:
    """log_focal (2,) [log px] and log_sigma (2,) an eye; damping, the same for both eyes."""

    log_focal: Float
    log_sigma: Float
    damping: float


def pooled(guesses: Float, bank_log_focal: Float, bank_log_sigma: Float) -> Pooled:
    """The posterior of both log focals; inf in bank_log_sigma (2,) where a bank cannot tell.

    guesses: (C, 2) log px of the sub-maps, an eye a column, C >= 1. Prior: the guesses' medians,
    with their scatter and a bias that is alike in both eyes; likelihood: the banks.
    """
    middle = np.median(guesses, 0)
    off = guesses - middle
    spread = np.maximum(_MAD_TO_SIGMA * np.median(np.abs(off), 0), _LEAST_SPREAD)
    n = len(guesses)
    alike = _alikeness(off)
    shape = np.array([[1.0, alike], [alike, 1.0]])
    prior = shape * (BIAS_LOG_SIGMA**2 + np.outer(spread, spread) / n)
    told = np.where(np.isfinite(bank_log_sigma), bank_log_sigma, np.inf) ** -2.0
    covariance = np.linalg.inv(np.linalg.inv(prior) + np.diag(told))
    step = covariance @ (told * np.where(told > 0, bank_log_focal - middle, 0.0))
    return Pooled(middle + step, np.sqrt(np.diag(covariance)), damping.from_guesses(n))


def _alikeness(off: Float) -> float:
    """Correlation of both eyes' deviations (C, 2), drawn towards none while there are few."""
    norm = float(np.sqrt((off**2).sum(0).prod()))
    if norm == 0:
        return 0.0
    measured = float(off[:, 0] @ off[:, 1]) / norm
    return float(np.clip(measured, 0, _MOST_ALIKE)) * len(off) / (len(off) + _HALF_BELIEVED)
