"""The focal a test bank asks for and how sure it is: Eq. Score minimised (past paper V-A)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from calm_edge.correction import spectral
from calm_edge.correction.test_bank import TestBank, focal_range
from calm_edge.geometry.camera import Camera
from calm_edge.types import Float

# Pairs of one window share their views, hence their noise: true errors of the minimum over what
# independent matrices would claim, measured on synthetic turns (bench/cost/focal_search.py).
_SHARED_NOISE = 1.65
# beyond it the verdict is "uninformative"; below, the damping follows the sigma
INFORMATIVE_LOG_SIGMA = 0.1
# a group less sure than this by itself is not heard: its minimum may lie anywhere
_LONGEST_LOG_SIGMA = 0.3
_SETTLED = 2e-3
_GRID = 24
_REWEIGHTINGS = 3
# median of a squared normal pair, over its mean
_MEDIAN_OF_TWO = 2 * np.log(2)


@dataclass(frozen=True, slots=True)
class BankFocal:
    """The bank's own minimum. log_focal: of px. log_sigma: one sigma, inf where it cannot tell.

    weights: (P,) of the matrices in the score. model_noise: of the score, what their matches'
    noise leaves unexplained.
    """

    log_focal: float
    log_sigma: float
    weights: Float
    model_noise: float


def minimise(bank: TestBank, shape: Camera, start: float, *, weighted: bool) -> BankFocal:
    """The focal of least score. start: the best candidate's focal [px].

    Plainly: of the mean score. weighted: each group's score, its matrices weighed by their
    information, has its own minimum; these agree but for noise and for the principal point, which
    errs alike in all of them and pulls each its own way, so their common focal is a generalised
    mean. Information is found anew where that lies.
    """
    x, plain = float(np.log(start)), np.ones(len(bank.F))
    if not weighted:
        x = _minimum(bank, shape, x, plain)
        _, log_sigma, _, model_noise = _common(bank, shape, x)
        return BankFocal(x, log_sigma, plain, model_noise)
    for _ in range(_REWEIGHTINGS):
        found, log_sigma, information, model_noise = _common(bank, shape, x)
        converged, x = abs(found - x) < _SETTLED, found
        if converged:
            break
    weights = information if information.any() else plain
    return BankFocal(x, log_sigma, weights, model_noise)


def _common(bank: TestBank, shape: Camera, x: float) -> tuple[float, float, Float, float]:
    """The groups' common log focal and its sigma, information (P,) and model noise, as at x."""
    model_noise = _model_noise(bank, shape, x)
    information = bank.information(x, model_noise)
    group, pulls = bank.group_of(), information[:, None] * bank.pull(x)
    told = np.bincount(group, information, minlength=len(bank.groups))
    (speaking,) = np.nonzero(told > _SHARED_NOISE**2 / _LONGEST_LOG_SIGMA**2)
    if len(speaking) == 0:
        everything = np.ones(len(group))
        return _minimum(bank, shape, x, everything), float(np.inf), information, model_noise
    minima = np.array([_minimum(bank, shape, x, information * (group == g)) for g in speaking])
    pull = np.stack([pulls[group == g].sum(0) / told[g] for g in speaking])
    inverse = np.linalg.inv(np.diag(_SHARED_NOISE**2 / told[speaking]) + pull @ pull.T)
    found = float(inverse.sum(0) @ minima / inverse.sum())
    disagreement = (minima - found) @ inverse @ (minima - found) / max(len(minima) - 1, 1)
    sigma = float(np.sqrt(max(1.0, disagreement) / inverse.sum()))
    low, high = np.log(focal_range(shape))
    found = float(np.clip(found, low, high))
    informed = sigma <= INFORMATIVE_LOG_SIGMA and low < found < high
    return found, sigma if informed else float(np.inf), information, model_noise


def _minimum(bank: TestBank, shape: Camera, x: float, weights: Float) -> float:
    """log focal [px] of the least weighted score: on a grid and at x, then between neighbours."""
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
    """Of the score: added to the matches' noise it makes the typical score as large as it is."""
    scores = spectral.score_at(shape, np.exp(x), bank.F)
    weights, noise = bank.information(x), bank.noise(x)
    if not weights.any():
        return 0.0
    excess = np.median((scores**2 / _MEDIAN_OF_TWO - noise**2)[weights > 0])
    return float(np.sqrt(max(excess, 0.0)))
