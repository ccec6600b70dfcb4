"""Marginal of a window over the keyframes that the next one shares, as a prior for that one.

Fixed-lag smoothing (Leutenegger et al., "Keyframe-based visual-inertial odometry using nonlinear
optimization", IJRR 2015, section 4): the keyframes that leave are marginalised out. The next window
measures the shared keyframes again, so what these say alone is taken out first; what is left is not
negative, as a minimum over more unknowns is not larger. Points are marginalised too, so both
windows place theirs by the same pixels of the shared keyframes: together they claim up to a
twentieth less sigma than one solution of both. The prior holds given the kit. What the window says
of the kit is its evidence (solver.kit_evidence), which reaches the next window in the belief, and
would count twice if it were in the poses as well.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calm_edge.backbones.bundle.normal_equations import (
    Normal,
    Structure,
    fix_spacing,
    normal_equations,
)
from calm_edge.backbones.bundle.problem import Measurements, RigTies, State
from calm_edge.geometry import se3
from calm_edge.kit import layout
from calm_edge.types import Float, Hints, Int, Overlap

# Added to the diagonal of eliminated poses, so that one without measurements is invertible.
_FLOOR = 1e-9
# Largest sigma [spacings, rad] of a direction in which the poses count as known.
_UNKNOWN_SIGMA = 1e3
# Least factor that `drawn` reports, and the inverse of the largest.
_MOST_DRAWN = 0.05


@dataclass(frozen=True, slots=True)
class OverlapPrior:
    """Prior on the first F primary views of a window, as a term of its bundle adjustment.

    views: (F,) their indices. information: (6 F - 6, 6 F - 6) in the currency of the pixels.
    """

    overlap: Overlap
    views: Int
    information: Float

    def residual(self, state: State) -> Float:
        """Twists (6 F - 6,) from the mean for the state's kit to the poses, camera axes."""
        o = self.overlap
        return np.asarray(self.difference(state) - o.offset - o.by_kit @ (state.theta - o.kit))

    def difference(self, state: State) -> Float:
        """Twists (6 F - 6,) from the previous window's poses to these, camera axes."""
        off = se3.log(self._T_k_first(state) @ self.overlap.T_first_k[1:])
        return np.asarray(off.reshape(-1))

    def cost(self, state: State) -> float:
        """Squared Mahalanobis distance of a state."""
        e = self.residual(state)
        return float(e @ self.information @ e)

    def jacobian(self, state: State) -> Float:
        """Derivative (6 F - 6, 6 C + SIZE) of the residual by left twists of T_c_s, and the kit."""
        T_k_first = self._T_k_first(state)
        off = se3.log(T_k_first @ self.overlap.T_first_k[1:])
        by_k = se3.right_jacobian_inverse(-off)
        by_first = -by_k @ se3.adjoint(T_k_first)
        J = np.zeros((len(off), 6, 6 * len(state.T_c_s) + layout.SIZE))
        first = 6 * self.views[0]
        J[:, :, first : first + 6] = by_first
        for k, view in enumerate(self.views[1:]):
            J[k, :, 6 * view : 6 * view + 6] = by_k[k]
        flat = J.reshape(-1, J.shape[-1])
        flat[:, -layout.SIZE :] = -self.overlap.by_kit
        return flat

    def add_to(self, H: Float, g: Float, state: State) -> None:
        """Add the prior, linearised at the state, to normal equations of poses and kit."""
        J = self.jacobian(state)
        weighted = J.T @ self.information
        H += weighted @ J
        g += weighted @ self.residual(state)

    def _T_k_first(self, state: State) -> Float:
        T = state.T_c_s[self.views]
        return np.asarray(T[1:] @ se3.inverse(T[0]))


def prior(hints: Hints, tempering: float) -> OverlapPrior | None:
    """The prior of `hints.overlap`; None if the window does not begin with its keyframes.

    tempering: factor on the information of pixels, which the solver counts fully.
    """
    o, primary = hints.overlap, np.flatnonzero(hints.eyes == 0)
    if o is None or hints.n_overlap != len(o.t_ns):
        return None
    views = primary[: len(o.t_ns)]
    if not np.array_equal(hints.t_ns[views], o.t_ns):
        return None
    return OverlapPrior(o, views, o.information / tempering)


def measured(state: State, m: Measurements, ties: RigTies, weight: Float) -> Normal:
    """Normal equations of a window's measurements alone. weight: (O,) robust weights."""
    return normal_equations(state, m, ties, Structure.of(m, len(state.points)), weight, 0.0)


def marginal(
    normal: Normal,
    state: State,
    m: Measurements,
    ties: RigTies,
    weight: Float,
    before: OverlapPrior | None,
    t_ns: Int,
    n_shared: int,
    tempering: float,
) -> Overlap | None:
    """Marginal over the last `n_shared` primary views; None if the window has no more than these.

    normal: `measured` at the solution. before: the prior that it was solved with. t_ns: (C,) stamps
    of the views.
    """
    (primary,) = np.nonzero(m.eye == 0)
    shared = primary[-n_shared:]
    if n_shared < 2 or len(primary) <= n_shared:
        return None
    H, g = normal.H.copy(), normal.g.copy()
    if before is not None:
        before.add_to(H, g, state)
    again = np.concatenate([shared, _nearest_assistants(m, shared)])
    H_all, g_all = _reduced(H, g, np.arange(m.n_views), shared)
    kept = np.isin(m.view, again)
    of_shared = measured(state, m.at(kept), _ties_between(ties, again), weight[kept])
    H_again, g_again = _reduced(of_shared.H, of_shared.g, again, shared)
    return _given_kit(H_all - H_again, g_all - g_again, state, shared, t_ns[shared], tempering)


def mismatch(before: OverlapPrior, normal: Normal, state: State, kit: Float) -> float:
    """Chi-square by degree of freedom of a prior against a window solved without it.

    normal: `measured` at the solution. kit: (SIZE, SIZE) information on the kit. Pixels are counted
    fully here: what makes the errors along a track correlated is common to both windows and
    cancels.
    """
    J, H_J = _moved(before, normal, state, kit)
    spread, e = J @ H_J, before.residual(state)
    values, vectors = np.linalg.eigh(before.information)
    known = values > _UNKNOWN_SIGMA**-2
    if not known.any():
        return 0.0
    # whitened by the prior's own sigma, so that directions unknown to it drop out
    L = vectors[:, known] * np.sqrt(values[known])
    white = L.T @ e
    both = L.T @ spread @ L + np.eye(len(white))
    return float(white @ np.linalg.solve(both, white)) / len(white)


def drawn(before: OverlapPrior, normal: Normal, state: State, kit: Float) -> Float:
    """How much the prior has drawn the shared poses to those of the previous window.

    (2,) factors on the differences of translations and of rotations between both windows' poses; 1
    for none, and by chance above. normal: `measured` at the solution. kit: (SIZE, SIZE)
    information on the kit that the solver had.
    """
    left = before.difference(state)
    J, H_J = _moved(before, normal, state, kit)
    J[:, -layout.SIZE :] = 0  # of the poses alone: the residual also moves with the kit
    back = J @ H_J @ before.information @ before.residual(state)
    sizes = [np.linalg.norm(twist.reshape(-1, 2, 3), axis=(0, 2)) for twist in (left, left + back)]
    return np.asarray(np.clip(sizes[0] / np.maximum(sizes[1], 1e-12), _MOST_DRAWN, 1 / _MOST_DRAWN))


def _moved(before: OverlapPrior, normal: Normal, state: State, kit: Float) -> tuple[Float, Float]:
    """Jacobian J of the prior's residual by all that is free, and H^-1 J^T.

    H: of the window's measurements, the pixels counted fully, and of the kit.
    """
    H = normal.H.copy()
    H[-layout.SIZE :, -layout.SIZE :] += kit
    fix_spacing(H, state.theta, layout.SPACING_SIGMA)
    H = H[6:, 6:] + _FLOOR * np.eye(len(H) - 6)
    J = before.jacobian(state)[:, 6:]
    return J, np.asarray(np.linalg.solve(H, J.T))


def _given_kit(
    H: Float, g: Float, state: State, shared: Int, t_ns: Int, tempering: float
) -> Overlap:
    """Gaussian on the poses of the shared views given the kit, from normal equations of both."""
    n = len(g) - layout.SIZE
    values, vectors = np.linalg.eigh((H[:n, :n] + H[:n, :n].T) / 2)
    known = tempering * values > 2 * _UNKNOWN_SIGMA**-2
    V, values = vectors[:, known], values[known]
    inverse = (V / values) @ V.T
    by_kit = -inverse @ H[:n, n:]
    # the length of t_p_a is the unit, and no freedom
    along = state.theta[layout.RIG_CENTRE]
    centre = by_kit[:, layout.RIG_CENTRE]
    by_kit[:, layout.RIG_CENTRE] = centre - np.outer(centre @ along, along) / (along @ along)
    T = state.T_c_s[shared]
    return Overlap(
        t_ns=t_ns,
        T_first_k=T[0] @ se3.inverse(T),
        offset=-inverse @ g[:n],
        information=tempering * (V * values) @ V.T,
        kit=state.theta,
        by_kit=by_kit,
    )


def _reduced(H: Float, g: Float, views: Int, shared: Int) -> tuple[Float, Float]:
    """Eliminate the poses of `views`, except those of `shared`, whose first one is held."""
    pose = np.arange(6)
    kit = np.arange(len(g) - layout.SIZE, len(g))
    kept = np.concatenate([(6 * shared[1:, None] + pose).reshape(-1), kit])
    gone = (6 * np.setdiff1d(views, shared)[:, None] + pose).reshape(-1)
    own = H[np.ix_(gone, gone)] + _FLOOR * np.eye(len(gone))
    coupled = H[np.ix_(gone, kept)]
    solved = np.linalg.solve(own, np.c_[coupled, g[gone]])
    return H[np.ix_(kept, kept)] - coupled.T @ solved[:, :-1], g[kept] - coupled.T @ solved[:, -1]


def _nearest_assistants(m: Measurements, shared: Int) -> Int:
    """The assistant views closest in time to the shared views: the next window has them too."""
    (assistant,) = np.nonzero(m.eye == 1)
    apart = np.abs(m.t[assistant] - m.t[shared][:, None])
    return np.unique(assistant[apart.argmin(1)])


def _ties_between(ties: RigTies, views: Int) -> RigTies:
    """The ties whose three views are all among `views`."""
    rows = np.isin(np.stack([ties.assistant, ties.before, ties.after]), views).all(0)
    fields = (
        "assistant",
        "before",
        "after",
        "alpha",
        "rate",
        "information_root",
        "late_s",
        "along",
    )
    return replace(ties, **{name: getattr(ties, name)[rows] for name in fields})
