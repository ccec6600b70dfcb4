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
from calm_edge.backbones.bundle.steps import Steps
from calm_edge.types import Float

# Sigma of the acceleration over the window's speed [1 / s]: 2 m/s^2 at 2 m/s, full braking at 8. In
# wrong solutions it is 3 to 13. CORRELATION_S: time in which a driver changes it.
ACCELERATION_SIGMA = 1.0
CORRELATION_S = 2.0
# Sigma of a stamp [s]; the jitter of all stamps adds to it. It changes the velocity of two steps.
STAMP_SIGMA_S = 1e-3


@dataclass(frozen=True, slots=True)
class MotionPrior:
    """Prior on the changes of velocity between P consecutive steps of the primary.

    whiten: (P - 1, P - 1) from changes, as shares of the window's speed, to sigmas.
    """

    steps: Steps
    whiten: Float

    def cost(self, state: State) -> float:
        """Sum of the squared residuals."""
        return float((self.residuals(state.T_c_s) ** 2).sum())

    def add_to(self, H: Float, g: Float, state: State) -> None:
        """Add the prior, linearised at the state, to normal equations that begin with the poses."""
        self.steps.add_to(H, g, *self.linearised(state.T_c_s))

    def residuals(self, T_c_s: Float) -> Float:
        """Changes of velocity (3 P - 3,) in sigmas."""
        return self._change(self.steps.shares(T_c_s)).ravel()

    def linearised(self, T_c_s: Float) -> tuple[Float, Float]:
        """Residuals and their derivatives (3 P - 3, 6 P + 6) by twists on the left of the views."""
        share, J = self.steps.linearised(T_c_s)
        return self._change(share).ravel(), self._change(J).reshape(-1, J.shape[-1])

    def _change(self, velocity: Float) -> Float:
        """Changes (P - 1, ...) of velocities (P, ...), whitened in time."""
        return np.asarray(np.tensordot(self.whiten, np.diff(velocity, axis=0), 1))


def motion_prior(m: Measurements, information_factor: float) -> MotionPrior:
    """The prior on a window's primary views; information_factor: on its information."""
    steps = Steps.of(m)
    t, seconds = m.t[steps.views], steps.seconds
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
    return MotionPrior(steps, information_factor**0.5 * whiten)
