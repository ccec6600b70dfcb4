"""How far a sub-map is drawn to the global intrinsics: the damping of V-C, in tenths."""

from __future__ import annotations

import numpy as np

from calm_edge.config import CorrectionConfig

STEP = 0.1


def from_density(n_matrices: float, config: CorrectionConfig) -> float:
    """The paper's: n_matrices / n_group over n_pair * n_feature."""
    density = n_matrices / config.n_group
    return _floored(density / (config.n_pair * config.n_feature))


def from_guesses(n: int) -> float:
    """1 - 1/n: with n guesses the common focal itself holds 1/n of each one's error."""
    wanted = 1 - 1 / max(n, 1)
    return 1.0 if wanted > 0.95 else _floored(wanted)


def _floored(value: float) -> float:
    return float(np.clip(round(np.floor(value / STEP + 1e-9) * STEP, 1), 0.0, 1.0))
