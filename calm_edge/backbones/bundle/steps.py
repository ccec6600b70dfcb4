"""Velocities of the primary from one keyframe to the next, as shares of the window's speed.

Shares have no unit: a prior on velocities in spacings would draw a window to a smaller scale.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calm_edge.backbones.bundle.problem import Measurements
from calm_edge.geometry import se3
from calm_edge.types import Float, Int

# The speed of a window is the mean of this power of its steps' speeds, to the inverse power: of a
# window in which the car stands or pulls away, that of the part in which it moves.
POWER = 4
# Slowest speed of a window [spacings / s]: below it the car stands.
SLOWEST = 1e-2


@dataclass(frozen=True, slots=True)
class Steps:
    """The P steps between P + 1 keyframes of the primary.

    views: (P + 1,) in order of time. seconds: (P,).
    """

    views: Int
    seconds: Float

    @classmethod
    def of(cls, m: Measurements) -> Steps:
        """The steps of a window."""
        views = np.flatnonzero(m.eye == 0)
        return cls(views, np.diff(m.t[views]))

    def twists(self, T_c_s: Float) -> Float:
        """Twists (P, 6), later from earlier camera axes."""
        T = T_c_s[self.views]
        return se3.log(T[1:] @ se3.inverse(T[:-1]))

    def velocities(self, T_c_s: Float) -> Float:
        """Velocities (P, 3) [spacings / s] of the scene in camera axes, steady over each step."""
        return self.twists(T_c_s)[:, :3] / self.seconds[:, None]

    def shares(self, T_c_s: Float) -> Float:
        """Velocities (P, 3) over the window's speed."""
        velocity = self.velocities(T_c_s)
        return velocity / speed(velocity)

    def linearised(self, T_c_s: Float) -> tuple[Float, Float]:
        """The shares, and their derivatives (P, 3, 6 P + 6) by twists on the left of the views."""
        twist = self.twists(T_c_s)
        velocity = twist[:, :3] / self.seconds[:, None]
        P = len(velocity)
        # log(exp(d_after) T exp(-d_before)) by the Jacobians of SE(3); left at xi: right at -xi
        by_step = np.zeros((P, 3, P + 1, 6))
        k, rate = np.arange(P), 1 / self.seconds[:, None, None]
        by_step[k, :, k] = -rate * se3.right_jacobian_inverse(twist)[:, :3]
        by_step[k, :, k + 1] = rate * se3.right_jacobian_inverse(-twist)[:, :3]
        J = by_step.reshape(P, 3, -1)
        whole = speed(velocity)
        size = np.linalg.norm(velocity, axis=1, keepdims=True)
        by_velocity = size ** (POWER - 2) * velocity / (P * whole ** (POWER - 1))
        by_speed = np.einsum("pi,piv->v", by_velocity, J)
        share = velocity / whole
        return share, (J - share[..., None] * by_speed) / whole

    def add_to(self, H: Float, g: Float, residual: Float, J: Float) -> None:
        """Add residuals (R,), with J (R, 6 P + 6), to normal equations beginning with poses."""
        rows = (6 * self.views[:, None] + np.arange(6)).ravel()
        H[np.ix_(rows, rows)] += J.T @ J
        g[rows] += J.T @ residual


def speed(velocity: Float) -> float:
    """Speed of a window by the velocities (P, 3) of its steps."""
    size = np.linalg.norm(velocity, axis=1)
    return float((np.mean(size**POWER) + SLOWEST**POWER) ** (1 / POWER))
