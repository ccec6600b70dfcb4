"""Whose an irregular stamp is: the camera's, exposed off its beat, or the host's, stamped late.

Stamps alone cannot tell. A window's pictures can: pixels place an assistant along the path where
it was, whatever its stamp says. So ties are first as soft along the path as the stamps are
irregular, the share of it that is the stamps' is read off, and only where that is told from none
are ties made stiff again at other instants.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calm_edge.backbones.bundle.problem import RigTies, State, tie_jacobians
from calm_edge.types import Float

# Less than this, one sigma, is no irregularity: a car moves a millimetre meanwhile.
LEAST_S = 1e-4
# A share of the irregularity this many sigmas from none is the stamps'.
TOLD_SIGMAS = 2.0
MIN_TIES = 4
STANDSTILL = 1e-3  # spacings a second, or their sigmas: below it no instant shows


def irregular(ties: RigTies) -> bool:
    """Whether some stamps may be wrong by more than LEAST_S."""
    return len(ties.off_beat) >= MIN_TIES and _spread(ties) > LEAST_S


def freed(ties: RigTies, state: State) -> RigTies:
    """Ties that hardly ask when an assistant was exposed, for poses near `state`."""
    return _softened(ties, state, _spread(ties)) if irregular(ties) else ties


def corrected(ties: RigTies, state: State) -> RigTies:
    """Ties at the instants that `state`, solved with `freed` ties, speaks for."""
    if not irregular(ties):
        return ties
    share, sigma = told_share(ties, state)
    if share < TOLD_SIGMAS * sigma:
        return ties
    late_s = -share * ties.off_beat
    moved = replace(ties, alpha=ties.alpha + ties.rate * late_s, late_s=late_s)
    return _softened(moved, state, sigma * _spread(ties))


def common_sigma_s(ties: RigTies) -> float:
    """One sigma that all instants of `corrected` ties share: their beats are known no better."""
    return float(np.sqrt(np.mean(ties.late_s**2) / len(ties.late_s)))


def told_share(ties: RigTies, state: State) -> tuple[float, float]:
    """The share of the irregularity that is the stamps', in [0, 1], and one sigma of it.

    By regression of the lateness that the assistant's place along the path speaks for.
    """
    root, residual, by_late = _unwhitened(ties, state)
    speed = np.maximum((by_late**2).sum(1), STANDSTILL**2)
    late = -(by_late * residual).sum(1) / speed
    design = np.stack([-ties.off_beat, np.ones_like(late)], 1)
    found = np.linalg.lstsq(design, late, rcond=None)[0]
    left = late - design @ found
    # a tie knows the instant no better than the rig is stiff
    stiff = 1 / np.maximum(((root * by_late) ** 2).sum(1), STANDSTILL**2)
    variance = float(left @ left) / (len(late) - 2) + float(stiff.mean())
    centred = ties.off_beat - ties.off_beat.mean()
    return float(np.clip(found[0], 0, 1)), float(np.sqrt(variance / (centred @ centred)))


def _spread(ties: RigTies) -> float:
    return float(np.sqrt(np.mean(ties.off_beat**2)))


def _unwhitened(ties: RigTies, state: State) -> tuple[Float, Float, Float]:
    """One over sigma, residuals and derivatives by lateness, each (A, 6), of stiff ties."""
    stiff = replace(ties, along=np.zeros_like(ties.along))
    residual, J = tie_jacobians(state, stiff)
    root = ties.information_root
    return root, residual / root, J[..., -1] / root


def _softened(ties: RigTies, state: State, sigma_s: float) -> RigTies:
    """Ties whose instants are known to sigma_s only: D + sigma^2 d d^T, d by lateness.

    Its inverse root is (I - a a^T) D^-1/2 with a along D^-1/2 d.
    """
    root, _, by_late = _unwhitened(ties, state)
    d = root * by_late
    squared = np.maximum((d * d).sum(1, keepdims=True), STANDSTILL**2)
    shrink = 1 - 1 / np.sqrt(1 + sigma_s**2 * squared)
    return replace(ties, along=d * np.sqrt(shrink / squared))
