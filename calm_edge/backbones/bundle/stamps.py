"""Correct timestamps for host delay: pictures exposed regularly, but stamped irregularly.

Irregular exposures with correct stamps cause the same jitter and must not be corrected. The
pictures distinguish the two: they determine the position of an assistant view on the path
independently of its stamp. So a window is first solved with ties that are softened along the path
by the jitter. Then the share of the jitter that is host delay is estimated, and if it is
significant the instants are corrected and the ties made stiff again.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calm_edge.backbones.bundle.problem import RigTies, State, tie_jacobians
from calm_edge.types import Float

# Jitter with a sigma below this is ignored: a car moves a millimetre in this time.
LEAST_S = 1e-4
# The share of host delay is significant if it is above this many sigmas.
SIGNIFICANT_SIGMAS = 2.0
MIN_TIES = 4
STANDSTILL = 1e-3  # spacings per second, or sigmas per second: too slow to determine an instant


def irregular(ties: RigTies) -> bool:
    """Whether the stamps have an rms jitter above LEAST_S, and enough ties to correct it."""
    return len(ties.jitter_s) >= MIN_TIES and _spread(ties) > LEAST_S


def freed(ties: RigTies, state: State) -> RigTies:
    """Ties with the rms jitter as uncertainty of the exposure times, linearised at `state`.

    So the assistant's views may move along the path, as if exposed earlier or later.
    """
    return _softened(ties, state, _spread(ties)) if irregular(ties) else ties


def corrected(ties: RigTies, state: State) -> RigTies:
    """Correct the ties' exposure times for host delay, given a `state` solved with `freed` ties."""
    if not irregular(ties):
        return ties
    share, sigma = delay_share(ties, state)
    if share < SIGNIFICANT_SIGMAS * sigma:
        return ties
    late_s = -share * ties.jitter_s
    moved = replace(ties, alpha=ties.alpha + ties.rate * late_s, late_s=late_s)
    return _softened(moved, state, sigma * _spread(ties))


def common_sigma_s(ties: RigTies) -> float:
    """Sigma [s] left in the common time offset after the correction of jitter."""
    return float(np.sqrt(np.mean(ties.late_s**2) / len(ties.late_s)))


def delay_share(ties: RigTies, state: State) -> tuple[float, float]:
    """Share of the jitter that is host delay, in [0, 1], and its sigma.

    By linear regression of the time offsets that the assistant's positions along the path imply.
    """
    root, residual, by_late = _unwhitened(ties, state)
    speed = np.maximum((by_late**2).sum(1), STANDSTILL**2)
    late = -(by_late * residual).sum(1) / speed
    design = np.stack([-ties.jitter_s, np.ones_like(late)], 1)
    found = np.linalg.lstsq(design, late, rcond=None)[0]
    left = late - design @ found
    # variance of an instant [s^2] that follows from the sigma of its tie
    stiff = 1 / np.maximum(((root * by_late) ** 2).sum(1), STANDSTILL**2)
    variance = float(left @ left) / (len(late) - 2) + float(stiff.mean())
    centred = ties.jitter_s - ties.jitter_s.mean()
    return float(np.clip(found[0], 0, 1)), float(np.sqrt(variance / (centred @ centred)))


def _spread(ties: RigTies) -> float:
    return float(np.sqrt(np.mean(ties.jitter_s**2)))


def _unwhitened(ties: RigTies, state: State) -> tuple[Float, Float, Float]:
    """One over sigma, residuals, and their derivatives by the time offset, each (A, 6).

    Of the ties without softening; residuals in spacings and rad.
    """
    stiff = replace(ties, along=np.zeros_like(ties.along))
    residual, J = tie_jacobians(state, stiff)
    root = ties.information_root
    return root, residual / root, J[..., -1] / root


def _softened(ties: RigTies, state: State, sigma_s: float) -> RigTies:
    """Add an uncertainty sigma_s of the instants to ties.

    The covariance becomes D + sigma_s^2 d d^T, with D that of the stiff tie, d the derivative of
    the residual by the time offset. Its inverse root is (I - a a^T) D^-1/2, with a along D^-1/2 d.
    """
    root, _, by_late = _unwhitened(ties, state)
    d = root * by_late
    squared = np.maximum((d * d).sum(1, keepdims=True), STANDSTILL**2)
    shrink = 1 - 1 / np.sqrt(1 + sigma_s**2 * squared)
    return replace(ties, along=d * np.sqrt(shrink / squared))
