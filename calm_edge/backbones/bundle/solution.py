"""Solution of one window: from the first sound start, in two passes, judged, as a Prediction.

The first pass is solved without the previous window; its prior joins in the second if it agrees.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import islice

import numpy as np

from calm_edge.backbones.base import BackboneError
from calm_edge.backbones.bundle import overlap, posterior, stamps, window
from calm_edge.backbones.bundle.evidence import kit_evidence
from calm_edge.backbones.bundle.motion import motion_prior
from calm_edge.backbones.bundle.moving import without_moving
from calm_edge.backbones.bundle.overlap import OverlapPrior
from calm_edge.backbones.bundle.path_length import length_priors, rescaled
from calm_edge.backbones.bundle.problem import Measurements, RigTies, State
from calm_edge.backbones.bundle.sideways import sideways_prior
from calm_edge.backbones.bundle.solver import PosePrior, Solution, robust_weights, solve
from calm_edge.geometry import se3
from calm_edge.geometry.car_motion import contradiction
from calm_edge.kit import layout
from calm_edge.kit.belief import blurred, gaussian, product, sigmas
from calm_edge.types import Float, Hints, KitBelief, Prediction

# Factor on the pixels' information in the overlap, which is computed as if all observations were
# independent; those along a track or within a texture are correlated.
TEMPERING = 0.02
# Scale of the Cauchy kernel [sigmas of a match] in the first and the second pass: wide first, so
# that a poor start loses no match; then narrow, since wrong matches are biased: most give points
# that are too near, which shrinks the scene. TOLERANCES: relative decrease of the cost at which
# either pass stops; the first is only a start and need not be as exact.
ROBUST_SCALES = (2.0, 0.5)
TOLERANCES = (1e-3, 1e-4)
# Share of the observations that are of moving points above which a window is solved again without
# them: fewer hardly count in the robust kernel.
MANY_MOVE = 0.1
# A window whose solution is rejected is solved from this number of initial states at most.
MAX_STARTS = 4
# Factors on the information of the belief on the kit in either pass. HELD keeps the kit where it
# is, while poses and points move, so that no window bends the rig to its own errors; there a window
# that is solved again is linearised. A new window has a say of its own in its second pass.
HELD, FREE = 50.0, 1.0
# Largest median reprojection error [px]: above the first a window is rejected, above the second it
# gives no evidence on the kit. It is also rejected if a tenth of the errors exceeds MAX_TAIL_PX:
# of good windows it is below 2, of one from a wrong start with a median of 0.4 it was 8.
MAX_MEDIAN_PX, MAX_TAIL_PX = 2.0, 5.0
MAX_EVIDENCE_PX = 0.8
# Largest chi-square by degree of freedom of the overlap with the previous window at which it joins:
# of twelve, 99.95 % are below where both windows are right. The paper's windows never join.
MAX_MISMATCH = 3.0
# Above this one of the two windows is wrong; as earlier ones agreed with the previous one, the new
# one is rejected.
HOPELESS_MISMATCH = 30.0
HOPELESS = "bundle: it contradicts the previous window on the keyframes they share"
CONTRADICTED = "windows contradict each other on the keyframes they share: solved apart"


def first_sound(
    starts: Iterator[State],
    m: Measurements,
    ties: RigTies,
    beliefs: Mapping[layout.Families, KitBelief],
    hints: Hints,
) -> Prediction:
    """Solve from the first start whose solution is not rejected; raises BackboneError.

    beliefs: on the kit, by the families of its lenses.
    If it contradicts the previous window, one from another start that does not is preferred.
    """
    apart, failure = None, None
    for start in islice(starts, MAX_STARTS):
        belief = beliefs[layout.families(start.theta)]
        try:
            found = solved(start, m, ties, belief, hints, belief, FREE)
        except BackboneError as error:
            failure = failure or error
            continue
        mismatch = found.overlap_mismatch
        if mismatch is None or mismatch <= MAX_MISMATCH:
            return found
        if mismatch > HOPELESS_MISMATCH:
            failure = failure or BackboneError(HOPELESS)
            continue
        apart = apart or found
    if apart is not None:
        return apart
    assert failure is not None
    raise failure


def solved(
    start: State,
    m: Measurements,
    ties: RigTies,
    belief: KitBelief,
    hints: Hints,
    held: KitBelief,
    factor: float,
) -> Prediction:
    """Solve a window from an initial state; with what the next window may take over from it.

    held, factor: the belief that holds the kit meanwhile, and the factor on its information in the
    second pass.
    """
    before = overlap.prior(hints, TEMPERING)
    solution, m, ties, mismatch = _solve(start, m, ties, held, before, hints.travel, factor)
    notices: tuple[str, ...] = ()
    if mismatch is not None and mismatch > MAX_MISMATCH:
        notices, before = (CONTRADICTED,), None
    prior = kit_prior(stiffened(held, factor), ties)
    known = posterior.posterior(solution, m, ties, prior, ROBUST_SCALES[-1], factor)
    lengths = length_priors(hints, m, solution.state, known)
    if lengths:
        priors = (*car_priors(m, hints.travel), *lengths)
        solution = solve(
            rescaled(solution.state, m, lengths[0]), m, ties, prior,
            pose_priors=priors if before is None else (*priors, before),
            robust_scale=ROBUST_SCALES[-1], tolerance=TOLERANCES[-1],
        )  # fmt: skip
        _check(solution, m)
        known = posterior.posterior(solution, m, ties, prior, ROBUST_SCALES[-1], factor)
        for one in lengths:
            known = known.joined(one.jacobian(solution.state), one.information, one.log_sigma)
    found = replace(_prediction(m, belief, solution, ties, known), notices=notices)
    if before is None and not hints.n_shared:
        return found
    state, weight = solution.state, robust_weights(solution.residual, ROBUST_SCALES[-1])
    normal = overlap.measured(state, m, ties, weight)
    ahead = overlap.marginal(
        normal, state, m, ties, weight, before, hints.t_ns, hints.n_shared, TEMPERING
    )
    drawn = None
    if before is not None:
        drawn = overlap.drawn(before, normal, state, prior.information)
    return replace(found, overlap=ahead, overlap_mismatch=mismatch, drawn=drawn)


def car_priors(m: Measurements, travel: Float | None) -> tuple[PosePrior, ...]:
    """Priors on how a car moves; travel: (3,) its direction, primary axes, or None: unknown."""
    return motion_prior(m, 1 / TEMPERING), sideways_prior(m, travel)


def stiffened(belief: KitBelief, factor: float) -> KitBelief:
    """Gaussian of the belief with `factor` times its information."""
    held = gaussian(belief)
    return KitBelief(held.mean, factor * held.information)


def kit_prior(stiff: KitBelief, ties: RigTies) -> KitBelief:
    """Prior on the kit that a window with these ties is solved with, from the stiffened belief."""
    return layout.with_time_jitter(stiff, stamps.common_sigma_s(ties))


def _solve(
    start: State,
    m: Measurements,
    ties: RigTies,
    belief: KitBelief,
    before: OverlapPrior | None,
    travel: Float | None,
    factor: float,
) -> tuple[Solution, Measurements, RigTies, float | None]:
    """Solve a window in two passes; factor: on the belief's information in the second.

    travel: (3,) direction of travel of earlier windows, primary axes, or None.

    In the second pass the ties' exposure times are corrected for delay of the stamps (stamps.py),
    and the prior `before`, on the overlap with the previous window, joins if it agrees with the
    first pass (MAX_MISMATCH). Points that move by themselves are left out at the end.

    Returns the solution, the measurements of its points, the rig ties of the second pass, and the
    overlap's mismatch, if any.
    """
    mismatch = None
    priors = car_priors(m, travel)
    passes = zip(
        ROBUST_SCALES, TOLERANCES, (HELD, factor), (stamps.freed, stamps.corrected), strict=True
    )
    for robust_scale, tolerance, stiff, timed in passes:
        timed_ties = timed(ties, start)
        kit = kit_prior(stiffened(belief, stiff), timed_ties)
        solution = solve(
            start, m, timed_ties, kit,
            pose_priors=priors, robust_scale=robust_scale, tolerance=tolerance,
        )  # fmt: skip
        start = solution.state
        if before is not None and mismatch is None:
            weight = robust_weights(solution.residual, ROBUST_SCALES[-1])
            normal = overlap.measured(start, m, timed_ties, weight)
            mismatch = overlap.mismatch(before, normal, start, gaussian(belief).information)
            if mismatch <= MAX_MISMATCH:
                priors = (*priors, before)
    n = len(m.uv)
    solution, m = without_moving(solution, m)
    if len(m.uv) < (1 - MANY_MOVE) * n:
        solution = solve(
            solution.state, m, timed_ties, kit,
            pose_priors=priors, robust_scale=robust_scale, tolerance=tolerance,
        )  # fmt: skip
    _check(solution, m)
    return solution, m, timed_ties, mismatch


def _check(solution: Solution, m: Measurements) -> None:
    """Raise BackboneError if a solution does not fit its pictures, or a car's motion."""
    median, tail = np.percentile(solution.residual * m.sigma_px, [50, 90])
    if median > MAX_MEDIAN_PX or tail > MAX_TAIL_PX:
        raise BackboneError("bundle: the pictures do not fit one rigid scene")
    primary = np.flatnonzero(m.eye == 0)
    why = contradiction(m.t[primary], se3.inverse(solution.state.T_c_s[primary]))
    if why:
        raise BackboneError(f"bundle: {why}")
    window.lenses(solution.state, m)


def _prediction(
    m: Measurements,
    belief: KitBelief,
    solution: Solution,
    ties: RigTies,
    known: posterior.Posterior,
) -> Prediction:
    """Prediction of a solved window."""
    state = solution.state
    evidence = _evidence(solution, m, ties, belief)
    joint = product([belief, evidence])
    assert joint is not None
    sigma = np.hypot(sigmas(joint), joint.mean - state.theta)[layout.LOG_FOCAL]
    cameras = layout.cameras(state.theta, m.size)
    # a window may show its own focals better than all windows together are known to
    scale_sigma = max(known.scale_log_sigma(state, m), float(sigma.min()))
    return Prediction(
        cameras=tuple(cameras[eye] for eye in m.eye),
        T_s_c=se3.inverse(state.T_c_s),
        focal_log_sigma=sigma[m.eye],
        landmarks=window.to_landmarks(state, m),
        kit=evidence,
        assistant_late_s=float(state.theta[layout.TIME_OFFSET]),
        stamps_off_s=ties.late_s if ties.late_s.any() else None,
        scale_log_sigma=np.inf if evidence is None else scale_sigma,
        covariance=known.of_views(np.flatnonzero(m.eye == 0)).astype(np.float32),
    )


def _evidence(
    solution: Solution, m: Measurements, ties: RigTies, belief: KitBelief
) -> KitBelief | None:
    """Evidence of a solved window on the kit; None if the residuals are too large.

    It is linear about the solution. What is quadratic in the step from there to the mean is taken
    for as large as the step times its log focal, and added.
    """
    if np.median(solution.residual * m.sigma_px) >= MAX_EVIDENCE_PX:
        return None
    evidence = kit_evidence(solution, m, ties, ROBUST_SCALES[-1])
    evidence = layout.with_time_jitter(evidence, stamps.common_sigma_s(ties))
    joint = product([belief, evidence])
    assert joint is not None
    step = joint.mean - solution.state.theta
    return blurred(evidence, step, float(np.abs(step[layout.LOG_FOCAL]).max()))
