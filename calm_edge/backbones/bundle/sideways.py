"""Prior on the direction of motion: a car does not move sideways.

Where nearly all points are far, pixels hardly tell a step ahead from a smaller one to the side: a
bias of a tenth of a pixel turned the direction of travel by 60 degrees within a window, and took
the scale with it. Wheels do not slip (the nonholonomic constraint of a car; Scaramuzza,
"1-Point-RANSAC Structure from Motion for Vehicle-Mounted Cameras", IJCV 2011), but a camera that
sits ahead of the rear axle moves sideways by the turn rate times its distance, which is not known.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from calm_edge.backbones.bundle.problem import Measurements, State
from calm_edge.backbones.bundle.steps import Steps
from calm_edge.types import Float

# Sigmas of the direction of travel [rad]: of a whole window against the one found in earlier
# windows, or where none is known against straight ahead; of departures from it that last for
# LASTING_S, by slope and camber of the road and by a driver who weaves; of single steps, by bumps.
# Of 9 drives with truth, three real ones, a step departs by 0.2 to 5 degrees. Against pixels, which
# the solver counts fully, so wide a prior only rules out what no car does.
REMEMBERED, UNKNOWN = 0.1, 1.0
DEPARTURE, LASTING_S = 0.1, 1.0
BUMP = 0.015
# Sigma of the time [s] in which the car goes as far as the camera is from the rear axle. Its speed
# in spacings is not used: a slower car would be less held, which draws the window to a small scale.
LEVER_S = 0.5


@dataclass(frozen=True, slots=True)
class SidewaysPrior:
    """Prior on the velocities of P steps across the direction of travel.

    across: (2, 3) unit vectors, camera axes. covariance: (P, P) of one of both, as a share of the
    window's speed, but for the turns.
    """

    steps: Steps
    across: Float
    covariance: Float

    def cost(self, state: State) -> float:
        """Sum of the squared residuals."""
        share = self.steps.shares(state.T_c_s)
        residual = self._whitened((share @ self.across.T).reshape(-1, 1), state.T_c_s)
        return float((residual**2).sum())

    def add_to(self, H: Float, g: Float, state: State) -> None:
        """Add the prior, linearised at the state, to normal equations that begin with the poses."""
        self.steps.add_to(H, g, *self.linearised(state.T_c_s))

    def linearised(self, T_c_s: Float) -> tuple[Float, Float]:
        """Residuals (2 P,) in sigmas, and derivatives (2 P, 6 P + 6) by twists on the left."""
        share, J = self.steps.linearised(T_c_s)
        both = np.concatenate([(share @ self.across.T)[..., None], self.across @ J], 2)
        white = self._whitened(both.reshape(-1, both.shape[-1]), T_c_s)
        return white[:, 0], white[:, 1:]

    def _whitened(self, values: Float, T_c_s: Float) -> Float:
        """Values (2 P, N) in sigmas, of steps and directions across."""
        turn = LEVER_S * self.steps.twists(T_c_s)[:, 3:] / self.steps.seconds[:, None]
        along = turn @ self.across.T
        # covariance of the cross products of all turns with one lever of any direction
        covariance = np.einsum("ij,ab->iajb", self.covariance + turn @ turn.T, np.eye(2))
        covariance -= np.einsum("ja,ib->iajb", along, along)
        n = 2 * len(turn)
        root = np.linalg.cholesky(covariance.reshape(n, n))
        return np.asarray(solve_triangular(root, values, lower=True))


def sideways_prior(m: Measurements, travel: Float | None) -> SidewaysPrior:
    """The prior on a window's primary views.

    travel: (3,) direction of travel of earlier windows, camera axes; None: unknown.
    """
    steps = Steps.of(m)
    t = m.t[steps.views]
    late = np.abs(np.subtract.outer(*[(t[1:] + t[:-1]) / 2] * 2))
    common = UNKNOWN if travel is None else REMEMBERED
    covariance = common**2 + DEPARTURE**2 * np.exp(-late / LASTING_S) + BUMP**2 * np.eye(len(late))
    ahead = np.array([0.0, 0.0, 1.0]) if travel is None else travel
    across = np.linalg.svd(ahead[None])[2][1:]
    return SidewaysPrior(steps, across, covariance)
