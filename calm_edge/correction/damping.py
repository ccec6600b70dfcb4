"""Damping factor lambda of paper V-C: share of the focal error to correct, in tenths."""

from __future__ import annotations

import numpy as np

from calm_edge.config import CorrectionConfig

STEP = 0.1


def from_density(n_matrices: float, config: CorrectionConfig) -> float:
    """Lambda of the paper: n_matrices / n_group / (n_pair * n_feature), floored to tenths."""
    density = n_matrices / config.n_group
    return _floored(density / (config.n_pair * config.n_feature))


def from_guesses(n: int) -> float:
    """Lambda 1 - 1/n, in tenths: the mean of n focal estimates has 1/n of the variance of each."""
    wanted = 1 - 1 / max(n, 1)
    return 1.0 if wanted > 0.95 else _floored(wanted)


def _floored(value: float) -> float:
    return float(np.clip(round(np.floor(value / STEP + 1e-9) * STEP, 1), 0.0, 1.0))
