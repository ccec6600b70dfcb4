"""How far an error of the scale moves the position of the live pose."""

from __future__ import annotations

import numpy as np

from calm_edge.types import METRIC_LOG_SIGMA, Float


class ScaleOffset:
    """Sum over the path of step times sigma of the log scale, in the odometry frame.

    It is the displacement of the position for one sigma, if the errors of all sub-maps have the
    same cause, as the focal length. Steps whose lengths are not metric are left out: nothing is
    known of the position across them, and a metric pose after them is a new start.
    """

    def __init__(self) -> None:
        self._offset = np.zeros(3)
        self._last: Float | None = None

    def move(self, T_o_c: Float, log_sigma: float) -> Float:
        """Add the step to pose T_o_c (4, 4); return the sum (3,) in its camera's axes."""
        position = T_o_c[:3, 3]
        if self._last is not None and log_sigma <= METRIC_LOG_SIGMA:
            self._offset = self._offset + log_sigma * (position - self._last)
        self._last = position
        return np.asarray(T_o_c[:3, :3].T @ self._offset)
