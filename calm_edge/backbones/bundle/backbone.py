"""The bundle backbone: a visual geometry model (paper III) by matching and bundle adjustment.

Matches (classical or learned), an initial solution, bundle adjustment over poses, points, optics
and rig, then plane-sweep depth. The cameras need no calibration.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import islice

import cv2
import numpy as np
from numpy.typing import NDArray

from calm_edge.backbones.base import BackboneError
from calm_edge.backbones.bundle import loop_view, overlap, posterior, stamps, window
from calm_edge.backbones.bundle.apart import solved_apart
from calm_edge.backbones.bundle.evidence import kit_evidence
from calm_edge.backbones.bundle.matching import Matching
from calm_edge.backbones.bundle.motion import motion_prior
from calm_edge.backbones.bundle.overlap import OverlapPrior
from calm_edge.backbones.bundle.problem import Measurements, RigTies, State, rig_ties
from calm_edge.backbones.bundle.solver import PosePrior, Solution, robust_weights, solve
from calm_edge.backbones.bundle.starts import Known, initial_states
from calm_edge.config import BackboneConfig, Config
from calm_edge.geometry import se3
from calm_edge.geometry.car_motion import contradiction
from calm_edge.kit import layout
from calm_edge.kit.belief import blurred, covariance, gaussian, product
from calm_edge.loops.descriptor import PlaceDescriptor
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
# Largest sigma of the rig's rotation at which it guides the matching between the cameras and the
# start; below layout.KIT_KNOWN rig and focals are taken as they are to start from.
RIG_GUIDES_RAD = 0.04
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


class BundleBackbone:
    """Backbone `bundle`: poses, cameras and depth by matching and bundle adjustment.

    Stateless: the prior on the kit is in Hints.kit, the window's evidence in Prediction.kit.
    """

    def __init__(
        self,
        config: BackboneConfig,
        matching: Matching | None = None,
        notices: tuple[str, ...] = (),
        places: PlaceDescriptor | None = None,
    ) -> None:
        """matching: learned matcher, None: Lucas-Kanade. notices: for `Prediction.notices`.

        places: learned place descriptor of the same network, None without one.
        """
        self._seed, self._matching, self._notices = config.seed, matching, notices
        self.places = places

    @classmethod
    def from_config(cls, config: Config) -> BundleBackbone:
        """`bundle`, or `bundle:NAME_OR_FOLDER` with a model's network; raises BackboneError."""
        from calm_edge.backbones.onnx.precision import model_of, opened

        if not model_of(config):
            return cls(config.backbone)
        # imported only for a network: they need ONNX Runtime
        from calm_edge.backbones.bundle.features import FeatureNet
        from calm_edge.backbones.bundle.learned import LearnedMatching
        from calm_edge.backbones.bundle.place import LearnedPlace

        model = opened(config)
        net = FeatureNet(model.manifest, model.precision)
        return cls(config.backbone, LearnedMatching(net), model.notices, LearnedPlace(net))

    @property
    def expects_pictures(self) -> bool:
        """Whether to send keyframes early: a network can start before the window is complete."""
        return self._matching is not None

    def expect(self, image: NDArray[np.uint8]) -> None:
        """Start to encode a primary keyframe (H, W, 3) uint8 BGR, if there is a network."""
        if self._matching is not None:
            gray = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)
            self._matching.expect([gray], [], None)

    def infer(self, images: Sequence[NDArray[np.uint8]], hints: Hints) -> Prediction:
        """Poses, cameras and landmarks; `densify` adds depth. Raises BackboneError."""
        if hints.loop:
            alone = self.infer(images[:-1], hints.without_loop())
            return loop_view.with_loop(images, hints, alone)
        cv2.setRNGSeed(self._seed)
        belief = kit_belief(hints)
        sigma = self.kit_sigma(hints)
        guided, settled = bool(sigma[0] < RIG_GUIDES_RAD), bool(np.all(sigma < layout.KIT_KNOWN))
        with _solvable():
            m = window.measure(images, hints, belief.mean, guided, self._matching)
        try:
            with _solvable():
                ties, before = rig_ties(m), overlap.prior(hints, TEMPERING)
                # the previous window leads the start; whether it is right is judged later
                poses: list[PosePrior] = [motion_prior(m, 1 / TEMPERING)]
                if before is not None:
                    poses.append(before)
                known = Known(
                    _prior(_stiffened(belief, HELD), ties), poses, float(sigma[1]), guided,
                    settled, hints.travel, follows=before is not None,
                )  # fmt: skip
                starts = initial_states(m, ties, known)
                solved = _first_sound(starts, m, ties, belief, hints)
        except BackboneError as error:
            error.T_s_c_apart = _apart(m, belief, hints)
            raise
        apart = _apart(m, belief, hints)
        solved = window.with_known_offset(solved, hints)
        notices = (*self._notices, *solved.notices)
        return replace(solved, kit_sigma=sigma, notices=notices, T_s_c_apart=apart)

    def kit_sigma(self, hints: Hints) -> Float:
        """Sigmas (2,) of the rig's rotation [rad] and of the log focals under `hints.kit`."""
        sigma = _sigma(kit_belief(hints))
        return np.array([sigma[layout.RIG_ROTATION].max(), sigma[layout.LOG_FOCAL].max()])

    def resolve(self, prediction: Prediction, hints: Hints) -> Prediction:
        """Solve the views again from the prediction's landmarks; raises BackboneError.

        The kit is estimated again too, with `hints.kit` as prior.
        """
        if hints.loop:
            alone = self.resolve(prediction.without_loop(), hints.without_loop())
            return loop_view.placed_again(alone, prediction)
        belief = kit_belief(hints)
        with_own = kit_belief(replace(hints, kit=product([hints.kit, prediction.kit])))
        m, start = window.from_prediction(prediction, hints, with_own.mean)
        ties = rig_ties(m)
        with _solvable():
            solved = _solved(start, m, ties, belief, hints, with_own, HELD)
        solved = window.with_known_offset(solved, hints)
        return replace(solved, kit_sigma=prediction.kit_sigma)

    def densify(
        self, images: Sequence[NDArray[np.uint8]], hints: Hints, prediction: Prediction
    ) -> Prediction:
        """The prediction with plane-sweep depth and confidence (depth.py)."""
        if prediction.depth is not None:
            return prediction
        # `record` solves poses only and does not load this
        from calm_edge.backbones.bundle.depth import sweep_window

        depth, confidence = sweep_window(images, hints, prediction)
        return replace(prediction, depth=depth, confidence=confidence)


def kit_belief(hints: Hints) -> KitBelief:
    """Prior on the kit: product of layout.prior(hints.hfov_deg) and hints.kit.

    The time offset is what is left of it after the known offsets of the stamps.
    """
    prior = layout.with_time_jitter(layout.prior(hints.hfov_deg), hints.late_sigma_s)
    joint = product([prior, hints.kit])
    assert joint is not None
    length = np.linalg.norm(joint.mean[layout.RIG_CENTRE])
    if length > 1e-6:
        joint.mean[layout.RIG_CENTRE] /= length
    return joint


def _apart(m: Measurements, belief: KitBelief, hints: Hints) -> Float | None:
    if not hints.apart:
        return None
    try:
        with _solvable():
            return solved_apart(m, hints.travel, _stiffened(belief, HELD))
    except BackboneError:
        return None


def _sigma(belief: KitBelief) -> Float:
    return np.asarray(np.sqrt(np.diag(covariance(belief))))


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


def _stiffened(belief: KitBelief, factor: float) -> KitBelief:
    """Gaussian of the belief with `factor` times its information."""
    held = gaussian(belief)
    return KitBelief(held.mean, factor * held.information)


def _prior(stiff: KitBelief, ties: RigTies) -> KitBelief:
    """Prior on the kit that a window with these ties is solved with, from the stiffened belief."""
    return layout.with_time_jitter(stiff, stamps.common_sigma_s(ties))


@contextmanager
def _solvable() -> Iterator[None]:
    """Translate failures of numpy and OpenCV to BackboneError."""
    try:
        yield
    except (np.linalg.LinAlgError, cv2.error):
        raise BackboneError(
            "bundle: the pictures do not determine their poses (too few matches?)"
        ) from None


def _first_sound(
    starts: Iterator[State], m: Measurements, ties: RigTies, belief: KitBelief, hints: Hints
) -> Prediction:
    """Solve from the first start whose solution is not rejected; raises BackboneError.

    If it contradicts the previous window, one from another start that does not is preferred.
    """
    apart, failure = None, None
    for start in islice(starts, MAX_STARTS):
        try:
            found = _solved(start, m, ties, belief, hints, belief, FREE)
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


def _solved(
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
    solution, ties, mismatch = _solve(start, m, ties, held, before, factor)
    found = _prediction(m, belief, solution, ties, _stiffened(held, factor), factor)
    if mismatch is not None and mismatch > MAX_MISMATCH:
        found, before = replace(found, notices=(CONTRADICTED,)), None
    if before is None and not hints.n_shared:
        return found
    state, weight = solution.state, robust_weights(solution.residual, ROBUST_SCALES[-1])
    normal = overlap.measured(state, m, ties, weight)
    ahead = overlap.marginal(
        normal, state, m, ties, weight, before, hints.t_ns, hints.n_shared, TEMPERING
    )
    drawn = None
    if before is not None:
        drawn = overlap.drawn(
            before, normal, state, _prior(_stiffened(held, factor), ties).information
        )
    return replace(found, overlap=ahead, overlap_mismatch=mismatch, drawn=drawn)


def _solve(
    start: State,
    m: Measurements,
    ties: RigTies,
    belief: KitBelief,
    before: OverlapPrior | None,
    factor: float,
) -> tuple[Solution, RigTies, float | None]:
    """Solve a window in two passes; factor: on the belief's information in the second.

    In the second pass the ties' exposure times are corrected for delay of the stamps (stamps.py),
    and the prior `before`, on the overlap with the previous window, joins if it agrees with the
    first pass (MAX_MISMATCH).

    Returns the solution, the rig ties of the second pass, and the overlap's mismatch, if any.
    """
    mismatch = None
    priors: tuple[PosePrior, ...] = (motion_prior(m, 1 / TEMPERING),)
    passes = zip(
        ROBUST_SCALES, TOLERANCES, (HELD, factor), (stamps.freed, stamps.corrected), strict=True
    )
    for robust_scale, tolerance, stiff, timed in passes:
        timed_ties = timed(ties, start)
        solution = solve(
            start, m, timed_ties, _prior(_stiffened(belief, stiff), timed_ties),
            pose_priors=priors, robust_scale=robust_scale, tolerance=tolerance,
        )  # fmt: skip
        start = solution.state
        if before is not None and mismatch is None:
            weight = robust_weights(solution.residual, ROBUST_SCALES[-1])
            normal = overlap.measured(start, m, timed_ties, weight)
            mismatch = overlap.mismatch(before, normal, start, gaussian(belief).information)
            if mismatch <= MAX_MISMATCH:
                priors = (*priors, before)
    median, tail = np.percentile(solution.residual * m.sigma_px, [50, 90])
    if median > MAX_MEDIAN_PX or tail > MAX_TAIL_PX:
        raise BackboneError("bundle: the pictures do not fit one rigid scene")
    primary = np.flatnonzero(m.eye == 0)
    why = contradiction(m.t[primary], se3.inverse(solution.state.T_c_s[primary]))
    if why:
        raise BackboneError(f"bundle: {why}")
    return solution, timed_ties, mismatch


def _prediction(
    m: Measurements,
    belief: KitBelief,
    solution: Solution,
    ties: RigTies,
    stiff: KitBelief,
    factor: float,
) -> Prediction:
    """Prediction of a solved window; stiff: the belief it was solved with, stiffened by factor."""
    state = solution.state
    evidence = _evidence(solution, m, ties, belief)
    joint = product([belief, evidence])
    assert joint is not None
    sigma = np.hypot(_sigma(joint), joint.mean - state.theta)[layout.LOG_FOCAL]
    cameras = [lens.pinhole for lens in layout.cameras(state.theta, m.size)]
    prior = _prior(stiff, ties)
    known = posterior.posterior(solution, m, ties, prior, ROBUST_SCALES[-1], factor)
    return Prediction(
        cameras=tuple(cameras[eye] for eye in m.eye),
        T_s_c=se3.inverse(state.T_c_s),
        focal_log_sigma=sigma[m.eye],
        landmarks=window.to_landmarks(state, m),
        kit=evidence,
        assistant_late_s=float(state.theta[layout.TIME_OFFSET]),
        stamps_off_s=ties.late_s if ties.late_s.any() else None,
        scale_log_sigma=np.inf if evidence is None else known.scale_log_sigma(state, m),
        covariance=known.of_views(np.flatnonzero(m.eye == 0)).astype(np.float32),
    )
