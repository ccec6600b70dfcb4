"""Focal of least score (`spectral.score`) on a test bank, and its sigma; extends paper V-A.

A test bank holds fundamental matrices of image pairs of one camera, by which focals are scored.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from calm_edge.correction import spectral
from calm_edge.correction.test_bank import TestBank, focal_range
from calm_edge.geometry.camera import Camera
from calm_edge.types import Float

# Factor on sigma because pairs of a window share views, so that their errors are correlated;
# measured on synthetic turns (`python -m bench cost.search`).
_SHARED_NOISE = 1.65
# a bank with a larger sigma of log focal is uninformative
INFORMATIVE_LOG_SIGMA = 0.1
# a group with a larger sigma is not used: its minimum is arbitrary
_MAX_GROUP_LOG_SIGMA = 0.3
_CONVERGED = 2e-3
_GRID = 24
_REWEIGHTINGS = 3
# median of chi-square with two degrees of freedom, the distribution of squared scores
_CHI2_MEDIAN = 2 * np.log(2)


@dataclass(frozen=True, slots=True)
class BankFocal:
    """Focal that minimises the score on a test bank.

    log_focal: [log px]. log_sigma: its sigma, inf if the bank is uninformative. weights: (P,) of
    the matrices in the mean score. model_noise: sigma of the score in excess of the noise of the
    matches.
    """

    log_focal: float
    log_sigma: float
    weights: Float
    model_noise: float


def minimise(bank: TestBank, shape: Camera, start: float, *, weighted: bool) -> BankFocal:
    """Find the focal of least score. start: initial focal [px]. shape: gives the rest of K.

    Not weighted: the minimum of the mean score. weighted: the minima of the score of each group
    (the matrices of one sub-map), weighted by information, combined by generalised least squares.
    Their covariance contains the noise of each group and the error of the principal point, which is
    common to all groups but shifts each minimum differently. Iterated, as the information depends
    on the focal.
    """
    x, plain = float(np.log(start)), np.ones(len(bank.F))
    if not weighted:
        x = _minimum(bank, shape, x, plain)
        _, log_sigma, _, model_noise = _common(bank, shape, x)
        return BankFocal(x, log_sigma, plain, model_noise)
    for _ in range(_REWEIGHTINGS):
        found, log_sigma, information, model_noise = _common(bank, shape, x)
        converged, x = abs(found - x) < _CONVERGED, found
        if converged:
            break
    weights = information if information.any() else plain
    return BankFocal(x, log_sigma, weights, model_noise)


def _common(bank: TestBank, shape: Camera, x: float) -> tuple[float, float, Float, float]:
    """Estimate one log focal from all groups of the bank.

    Returns it, its sigma, the information (P,) of each F at log focal x, and the standard deviation
    of the score that is due to model error. shape: gives aspect ratio and principal point.
    """
    model_noise = _model_noise(bank, shape, x)
    information = bank.information(x, model_noise)
    group, shifts = bank.group_of(), information[:, None] * bank.centre_shift(x)
    totals = np.bincount(group, information, minlength=len(bank.groups))
    (used,) = np.nonzero(totals > _SHARED_NOISE**2 / _MAX_GROUP_LOG_SIGMA**2)
    if len(used) == 0:
        equal = np.ones(len(group))
        return _minimum(bank, shape, x, equal), float(np.inf), information, model_noise
    minima = np.array([_minimum(bank, shape, x, information * (group == g)) for g in used])
    shift = np.stack([shifts[group == g].sum(0) / totals[g] for g in used])
    inverse = np.linalg.inv(np.diag(_SHARED_NOISE**2 / totals[used]) + shift @ shift.T)
    found = float(inverse.sum(0) @ minima / inverse.sum())
    disagreement = (minima - found) @ inverse @ (minima - found) / max(len(minima) - 1, 1)
    sigma = float(np.sqrt(max(1.0, disagreement) / inverse.sum()))
    low, high = np.log(focal_range(shape))
    found = float(np.clip(found, low, high))
    informed = sigma <= INFORMATIVE_LOG_SIGMA and low < found < high
    return found, sigma if informed else float(np.inf), information, model_noise


def _minimum(bank: TestBank, shape: Camera, x: float, weights: Float) -> float:
    """Log focal [log px] of least weighted score: a grid search including x, then refinement."""
    (used,) = np.nonzero(weights)
    F, weights = bank.F[used], weights[used]

    def cost(log_focal: Float | float) -> Float:
        return np.asarray(np.average(spectral.score_at(shape, np.exp(log_focal), F), -1, weights))

    low, high = np.log(focal_range(shape))
    grid = np.sort(np.append(np.linspace(low, high, _GRID), np.clip(x, low, high)))
    best = int(np.argmin(cost(grid)))
    found = minimize_scalar(
        lambda log_focal: float(cost(log_focal)),
        bounds=(float(grid[max(best - 1, 0)]), float(grid[min(best + 1, len(grid) - 1)])),
        method="bounded",
        options={"xatol": 5e-4},
    )
    return float(found.x)


def _model_noise(bank: TestBank, shape: Camera, x: float) -> float:
    """Sigma of the score in excess of the noise of the matches, from the median score at x."""
    scores = spectral.score_at(shape, np.exp(x), bank.F)
    weights, noise = bank.information(x), bank.noise(x)
    if not weights.any():
        return 0.0
    excess = np.median((scores**2 / _CHI2_MEDIAN - noise**2)[weights > 0])
    return float(np.sqrt(max(excess, 0.0)))
