"""Motion prior of a car: its acceleration is bounded and changes slowly.

Where nearly all points are far, the length of a single step is all but free: pixels fit steps that
no car makes. The prior is on the acceleration in camera axes, so that a steady turn costs nothing,
and correlated in time (Singer, "Estimating Optimal Tracking Filter Performance for Manned
Maneuvering Targets", IEEE Trans. AES 1970), so that steady braking costs little. It is in units of
the window's own speed: in spacings it would draw every window that brakes to a smaller scale.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from calm_edge.backbones.bundle.jitter import jitter
from calm_edge.backbones.bundle.problem import Measurements, State
from calm_edge.geometry import se3
from calm_edge.types import Float, Int

# Sigma of the acceleration over the window's speed [1 / s]: 2 m/s^2 at 2 m/s, full braking at 8. In
# wrong solutions it is 3 to 13. CORRELATION_S: time in which a driver changes it.
ACCELERATION_SIGMA = 1.0
CORRELATION_S = 2.0
# Sigma of a stamp [s]; the jitter of all stamps adds to it. It changes the velocity of two steps.
STAMP_SIGMA_S = 1e-3
# The speed of a window is the mean of this power of its steps' speeds, to the inverse power: of a
# window in which the car stands or pulls away, that of the part in which it moves.
POWER = 4
# Slowest speed of a window [spacings / s]: below it the car stands.
SLOWEST = 1e-2


@dataclass(frozen=True, slots=True)
class MotionPrior:
    """Prior on the changes of velocity between P consecutive steps of the primary.

    views: (P + 1,) primary views in order of time. seconds: (P,) of the steps. whiten: (P - 1, P -
    1) from changes, as shares of the window's speed, to sigmas.
    """

    views: Int
    seconds: Float
    whiten: Float

    def cost(self, state: State) -> float:
        """Sum of the squared residuals."""
        return float((self.residuals(state.T_c_s) ** 2).sum())

    def add_to(self, H: Float, g: Float, state: State) -> None:
        """Add the prior, linearised at the state, to normal equations that begin with the poses."""
        rows = (6 * self.views[:, None] + np.arange(6)).ravel()
        residual, J = self.linearised(state.T_c_s)
        H[np.ix_(rows, rows)] += J.T @ J
        g[rows] += J.T @ residual

    def residuals(self, T_c_s: Float) -> Float:
        """Changes of velocity (3 P - 3,) in sigmas."""
        velocity = self._steps(T_c_s)[:, :3] / self.seconds[:, None]
        return np.asarray((self._change(velocity) / _speed(velocity)).ravel())

    def linearised(self, T_c_s: Float) -> tuple[Float, Float]:
        """Residuals and their derivatives (3 P - 3, 6 P + 6) by twists on the left of the views."""
        step = self._steps(T_c_s)
        velocity = step[:, :3] / self.seconds[:, None]
        P = len(velocity)
        # log(exp(d_after) T exp(-d_before)) by the Jacobians of SE(3); left at xi: right at -xi
        by_step = np.zeros((P, 3, P + 1, 6))
        k, rate = np.arange(P), 1 / self.seconds[:, None, None]
        by_step[k, :, k] = -rate * se3.right_jacobian_inverse(step)[:, :3]
        by_step[k, :, k + 1] = rate * se3.right_jacobian_inverse(-step)[:, :3]
        J = by_step.reshape(P, 3, -1)
        speed, change = _speed(velocity), self._change(velocity)
        size = np.linalg.norm(velocity, axis=1, keepdims=True)
        by_velocity = size ** (POWER - 2) * velocity / (P * speed ** (POWER - 1))
        by_speed = np.einsum("pi,piv->v", by_velocity, J)
        by_pose = self._change(J) - change[..., None] * (by_speed / speed)
        return (change / speed).ravel(), (by_pose / speed).reshape(-1, J.shape[-1])

    def _steps(self, T_c_s: Float) -> Float:
        """Twists (P, 6), later from earlier camera axes."""
        T = T_c_s[self.views]
        return se3.log(T[1:] @ se3.inverse(T[:-1]))

    def _change(self, velocity: Float) -> Float:
        """Changes (P - 1, ...) of velocities (P, ...), whitened in time."""
        return np.asarray(np.tensordot(self.whiten, np.diff(velocity, axis=0), 1))


def _speed(velocity: Float) -> float:
    size = np.linalg.norm(velocity, axis=1)
    return float((np.mean(size**POWER) + SLOWEST**POWER) ** (1 / POWER))


def motion_prior(m: Measurements, information_factor: float) -> MotionPrior:
    """The prior on a window's primary views; information_factor: on its information."""
    views = np.flatnonzero(m.eye == 0)
    t = m.t[views]
    seconds = np.diff(t)
    # instants of the changes, half way between the middles of two steps
    middle = (t[1:] + t[:-1]) / 2
    at, apart = (middle[1:] + middle[:-1]) / 2, np.diff(middle)
    late = np.abs(at[:, None] - at)
    covariance = np.outer(apart, apart) * ACCELERATION_SIGMA**2 * np.exp(-late / CORRELATION_S)
    by_stamp = np.diff(np.diff(np.eye(len(t)), axis=0) / seconds[:, None], axis=0)
    off = jitter(t)
    variance = STAMP_SIGMA_S**2 + (0.0 if off is None else float(np.mean(off**2)))
    root = np.linalg.cholesky(covariance + variance * by_stamp @ by_stamp.T)
    whiten = solve_triangular(root, np.eye(len(at)), lower=True)
    return MotionPrior(views, seconds, information_factor**0.5 * whiten)
