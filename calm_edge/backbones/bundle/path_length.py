"""Prior on the length of the path over the keyframes that a window shares with a neighbouring one.

Where nearly all points are far, the noise that the observations of a surface share sets the scale
of a window, and the solver treats it as independent: it then outweighs the previous window. So a
window whose posterior sigma of scale is much larger than a neighbour's is solved again with the
neighbour's length of the shared path as a prior, weighed by the ratio of the two sigmas.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calm_edge.backbones.bundle.posterior import Posterior, steps
from calm_edge.backbones.bundle.problem import Measurements, State
from calm_edge.geometry import se3
from calm_edge.geometry.polyline import path_length
from calm_edge.types import Float, Hints, Int, PathLength

# A window takes over the length if its own sigma is larger than the neighbour's by this factor:
# both contain what is not known of the kit, which the two have in common.
MUCH_SURER = 2.0
# It does not if the lengths differ by more than this many sigmas: one of the windows is wrong. A
# window with a sigma above POOR is the one: far points alone can give any scale.
CONTRADICTS, POOR = 4.0, 0.1
# Largest sigma of the log of a window's own length, whatever its posterior says: it is unknown.
OWN_UNKNOWN = 1.0


@dataclass(frozen=True, slots=True)
class LengthPrior:
    """Prior on the log of the length of the path through V consecutive views.

    views: (V,). length: [spacings]. log_sigma: of its log. information: in the solver's currency,
    in which a window's own noise has not its true size.
    """

    views: Int
    length: float
    log_sigma: float
    information: float

    def cost(self, state: State) -> float:
        """Squared length of the residual in sigmas."""
        return self.information * self._residual(state) ** 2

    def add_to(self, H: Float, g: Float, state: State) -> None:
        """Add the prior, linearised at the state, to normal equations that begin with the poses."""
        J = self.jacobian(state)
        n = len(J)
        H[:n, :n] += self.information * np.outer(J, J)
        g[:n] += self.information * self._residual(state) * J

    def jacobian(self, state: State) -> Float:
        """Derivative (6 C,) of the residual by twists on the left of the views."""
        step, by_pose = steps(state, self.views)
        size = np.maximum(np.linalg.norm(step, axis=1), 1e-12)
        # a twist on the left moves the scene in camera axes, so the centre the other way
        by_centre = np.einsum("si,sij->j", step / size[:, None], by_pose)
        return np.asarray(-by_centre / size.sum())

    def _residual(self, state: State) -> float:
        return float(np.log(_length(state, self.views) / self.length))


def length_priors(
    hints: Hints, m: Measurements, state: State, known: Posterior
) -> tuple[LengthPrior, ...]:
    """The priors for a solved window: by neighbours that are much surer and do not contradict it.

    The surest first. known: posterior of the window by itself.
    """
    ordered = sorted(hints.lengths, key=lambda one: one.log_sigma)
    made = (_length_prior(one, hints, m, state, known) for one in ordered)
    return tuple(prior for prior in made if prior is not None)


def _length_prior(
    other: PathLength, hints: Hints, m: Measurements, state: State, known: Posterior
) -> LengthPrior | None:
    (primary,) = np.nonzero(m.eye == 0)
    views = primary[np.isin(hints.t_ns[primary], other.t_ns)]
    if len(views) != len(other.t_ns) or not 0 < other.log_sigma < OWN_UNKNOWN:
        return None
    own = min(known.length_log_sigma(state, views), OWN_UNKNOWN)
    if own < MUCH_SURER * other.log_sigma:
        return None
    apart = np.log(_length(state, views) / other.spacings)
    if own < POOR and abs(apart) > CONTRADICTS * np.hypot(own, other.log_sigma):
        return None
    J = LengthPrior(views, other.spacings, 0.0, 0.0).jacobian(state)
    # information of the solver on this length, and by how much the posterior finds it too large
    solver = 1 / float(J @ known.inverse[: len(J), : len(J)] @ J)
    ratio = own / other.log_sigma
    return LengthPrior(views, other.spacings, other.log_sigma, solver * ratio**2)


def rescaled(state: State, m: Measurements, prior: LengthPrior) -> State:
    """The state with the length of the prior: path and points, but not the rig, are rescaled."""
    factor = prior.length / _length(state, prior.views)
    (primary,), (assistant,) = np.nonzero(m.eye == 0), np.nonzero(m.eye == 1)
    T_c_s = state.T_c_s.copy()
    T_c_s[primary, :3, 3] *= factor
    before, after = (
        se3.interpolate_at(m.t[primary], se3.inverse(T[primary]), m.t[assistant])
        for T in (state.T_c_s, T_c_s)
    )
    T_c_s[assistant] = state.T_c_s[assistant] @ before @ se3.inverse(after)
    points = state.points.copy()
    points[:, 3] /= factor
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    return State(T_c_s, points, state.theta)


def _length(state: State, views: Int) -> float:
    """Length [spacings] of the path through views (V,)."""
    return max(path_length(se3.inverse(state.T_c_s[views])[:, :3, 3]), 1e-12)
