"""Judge a solved window before it is placed: a wrong one is bridged instead.

For every backbone. What only its own residuals show, a backbone judges itself.
"""

from __future__ import annotations

import numpy as np

from calm_edge.backbones.base import BackboneError
from calm_edge.geometry.car_motion import contradiction
from calm_edge.types import Submap


def judge(submap: Submap, spacing: float) -> None:
    """Raise BackboneError for a sub-map that cannot be right. spacing: in its unit."""
    n = submap.n_primary
    T_s_p = submap.T_s_c[:n].copy()
    if not np.isfinite(T_s_p).all():
        raise BackboneError("a pose is not finite")
    T_s_p[:, :3, 3] /= spacing
    why = contradiction((submap.t_ns[:n] - submap.t_ns[0]) * 1e-9, T_s_p)
    if why:
        raise BackboneError(f"the window is wrong: {why}")
