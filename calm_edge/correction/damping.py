"""How far a sub-map is drawn to the global intrinsics: the damping of paper V-C, in tenths."""

from __future__ import annotations

import numpy as np

from calm_edge.config import CorrectionConfig
from calm_edge.types import Float

STEP = 0.1
# a step is left only when the damping wanted lies this far outside it: each change of step moves
# every sub-map
_HYSTERESIS = 0.05


def from_density(n_matrices: float, config: CorrectionConfig) -> float:
    """The paper's: n_matrices / n_group over n_pair * n_feature, floored to tenths, in [0, 1]."""
    density = n_matrices / config.n_group
    return _floored(density / (config.n_pair * config.n_feature))


def from_uncertainty(log_focals: Float, log_focal: float, log_sigma: float, held: float) -> float:
    """The share of a sub-map's own focal error that correcting it fully would really remove.

    log_focals: (C,) of the sub-maps' guesses; log_focal, log_sigma: of the search; held: the
    damping until now. Guesses deviate from the search's focal by both errors, m = own^2 +
    sigma^2; the mean square error left by damping d, (1 - d)^2 own^2 + d^2 sigma^2, is least at
    d = 1 - sigma^2 / m.
    """
    if not np.isfinite(log_sigma) or len(log_focals) == 0:
        return 0.0
    deviation2 = float(np.mean((log_focals - log_focal) ** 2))
    wanted = 1 - log_sigma**2 / deviation2 if deviation2 > 0 else 0.0
    if held - _HYSTERESIS <= wanted < held + STEP + _HYSTERESIS:
        return held
    # shrinkage never asks for all of it; what rounds to one is one
    return 1.0 if wanted > 1 - STEP / 2 else _floored(wanted)


def _floored(value: float) -> float:
    return float(np.clip(round(np.floor(value / STEP + 1e-9) * STEP, 1), 0.0, 1.0))
