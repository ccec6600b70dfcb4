"""How fast a camera moves now, from where it was."""

from __future__ import annotations

import numpy as np

from calm_edge.geometry import se3
from calm_edge.types import Float, Int


def velocity_now(t_ns: Int, T_o_c: Float) -> Float:
    """(3,) units/s in the last camera's axes, from stamps (N,) and poses (N, 4, 4); NaN for one.

    The slope of a parabola at its end: a mean over the window would be half a window old.
    """
    if len(t_ns) < 2:
        return np.full(3, np.nan)
    powers = np.vander((t_ns - t_ns[-1]) * 1e-9, min(3, len(t_ns)), increasing=True)
    moved = se3.transform(se3.inverse(T_o_c[-1]), T_o_c[:, :3, 3])
    return np.asarray(np.linalg.lstsq(powers, moved, rcond=None)[0][1])
