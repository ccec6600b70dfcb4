"""Drift of the live pose: error of its motion since the first metric pose of its epoch."""

from __future__ import annotations

import numpy as np

from calm_edge.frontend.submap_errors import SubmapErrors
from calm_edge.geometry import se3
from calm_edge.types import Float

# Points that the tracker triangulates inherit the errors of its poses, and points on one surface
# share theirs: as many as this count as one. When all points have been replaced, the pose has
# drifted by its error relative to them.
POINTS_ALIKE = 6.0


class Drift:
    """Accumulates errors along the path of the live pose, in axes of the last pose.

    covariance: (6, 6) of (translation, rotation), of what is independent from one part of the path
    to the next: errors of the windows, and of the points that the tracker adds. scale_offset: (3,)
    and focal_offset: (6,), how far one sigma of the scale and of the focal length moves the pose,
    if the errors of all sub-maps have the same cause.
    """

    def __init__(self) -> None:
        self.restart()

    def restart(self) -> None:
        """Begin anew: the next pose is the first."""
        self._last: Float | None = None
        self.covariance: Float = np.zeros((6, 6))
        self.scale_offset: Float = np.zeros(3)
        self.focal_offset: Float = np.zeros(6)

    def move(self, T_o_c: Float, errors: SubmapErrors, noise: Float, replaced: float) -> None:
        """Add the step to pose T_o_c (4, 4).

        errors: of the sub-map it is tracked in. noise: (6, 6) covariance of the pose relative to
        the tracked points. replaced: share of these that are new since the last pose.
        """
        if self._last is None:
            self._last = T_o_c
            return
        T_last_c = se3.inverse(self._last) @ T_o_c
        step, turn = T_last_c[:3, 3], se3.so3_log(T_last_c[:3, :3])
        to_here = se3.adjoint(se3.inverse(T_last_c))
        self.covariance = to_here @ self.covariance @ to_here.T
        self.covariance += np.linalg.norm(step) * errors.by_length
        self.covariance += POINTS_ALIKE * replaced * noise
        R = T_last_c[:3, :3].T
        self.scale_offset = R @ (self.scale_offset + errors.scale_log_sigma * step)
        self.focal_offset = to_here @ self.focal_offset + errors.of_turn(turn)
        self._last = T_o_c
