"""The bundle backbone: a visual geometry model (paper III) by matching and bundle adjustment.

Matches (classical or learned), an initial solution, bundle adjustment over poses, points, optics
and rig, then plane-sweep depth. The cameras need no calibration.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from calm_edge.backbones.base import BackboneError
from calm_edge.backbones.bundle import loop_view, overlap, solution, window
from calm_edge.backbones.bundle.apart import solved_apart
from calm_edge.backbones.bundle.matching import Matching
from calm_edge.backbones.bundle.problem import Measurements, State, rig_ties
from calm_edge.backbones.bundle.road import with_road
from calm_edge.backbones.bundle.starts import Known, initial_states
from calm_edge.config import BackboneConfig, Config
from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera
from calm_edge.geometry.fisheye import FieldTooWide
from calm_edge.kit import layout
from calm_edge.kit.belief import product, sigmas
from calm_edge.kit.lens import Family
from calm_edge.loops.descriptor import PlaceDescriptor
from calm_edge.types import Float, Hints, KitBelief, Prediction

# Largest sigma of the rig's rotation at which it guides the matching between the cameras and the
# start; below layout.KIT_KNOWN rig and focals are taken as they are to start from.
RIG_GUIDES_RAD = 0.04
# Sigma of the log scale above which points of the road are looked for.
ROAD_SIGMA = 0.03
# Families of the lenses that are tried where nothing is known, perspective ones first.
FAMILIES = (layout.PERSPECTIVE, *((p, a) for p in Family for a in Family if p or a))


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
        self._depth = config.depth_side_px, config.depth_every, config.reject_moving
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
        beliefs = kit_beliefs(hints)
        belief = next(iter(beliefs.values()))
        sigma = self.kit_sigma(hints)
        guided = bool(sigma[0] < RIG_GUIDES_RAD)
        with _solvable():
            kits = [each.mean for each in beliefs.values()]
            every = window.measure(images, hints, kits, guided, self._matching)
            m = window.with_enough_views(every)
        try:
            solved = self._solved(m, hints, beliefs)
        except BackboneError as error:
            solved, failure = None, error
        if solved is None or solved.kit is None:
            other = self._of_other_lenses(m, hints)
            solved, sigma = (solved, sigma) if other is None else other
        if solved is None:
            failure.T_s_c_apart = _apart(m, belief, hints)
            raise failure
        if _scale_sigma(solved) > ROAD_SIGMA:
            solved = _solved_on_road(every, solved, images, hints) or solved
        apart = _apart(m, belief, hints)
        solved = window.with_known_offset(solved, hints)
        notices = (*self._notices, *solved.notices)
        return replace(solved, kit_sigma=sigma, notices=notices, T_s_c_apart=apart)

    def _solved(
        self, m: Measurements, hints: Hints, beliefs: Mapping[layout.Families, KitBelief]
    ) -> Prediction:
        """Solve a window of lenses of any of the families of `beliefs`; raises BackboneError."""
        sigma = self.kit_sigma(hints)
        guided, settled = bool(sigma[0] < RIG_GUIDES_RAD), bool(np.all(sigma < layout.KIT_KNOWN))
        with _solvable():
            ties, before = rig_ties(m), overlap.prior(hints, solution.TEMPERING)
            # the previous window leads the start; whether it is right is judged later
            poses = solution.car_priors(m, hints.travel)
            if before is not None:
                poses = (*poses, before)
            kits = [
                solution.kit_prior(solution.stiffened(belief, solution.HELD), ties)
                for belief in beliefs.values()
            ]
            known = Known(
                kits, poses, float(sigma[1]), guided, settled, hints.travel,
                follows=before is not None,
            )  # fmt: skip
            starts = initial_states(m, ties, known)
            return solution.first_sound(starts, m, ties, beliefs, hints)

    def _of_other_lenses(self, m: Measurements, hints: Hints) -> tuple[Prediction, Float] | None:
        """Solve a window that does not fit the belief with lenses of another family.

        Only before the focals are known. With `kit_sigma`; None if the window gives no evidence on
        such a kit either.
        """
        if hints.kit is None or self.kit_sigma(hints)[1] < layout.FOCAL_KNOWN:
            return None
        anew = replace(hints.without_neighbours(), kit=None)
        beliefs = kit_beliefs(anew)
        del beliefs[layout.families(hints.kit.mean)]
        with suppress(BackboneError):
            solved = self._solved(m, anew, beliefs)
            if solved.kit is not None:
                return solved, self.kit_sigma(anew)
        return None

    def kit_sigma(self, hints: Hints) -> Float:
        """Sigmas (2,) of the rig's rotation [rad] and of the log focals under `hints.kit`."""
        sigma = sigmas(kit_belief(hints))
        return np.array([sigma[layout.RIG_ROTATION].max(), sigma[layout.LOG_FOCAL].max()])

    def resolve(self, prediction: Prediction, hints: Hints) -> Prediction:
        """Solve the views again from the prediction's landmarks; raises BackboneError.

        The kit is estimated again too, with `hints.kit` as prior.
        """
        if hints.loop:
            alone = self.resolve(prediction.without_loop(), hints.without_loop())
            return loop_view.placed_again(alone, prediction)
        belief, own = kit_belief(hints), prediction.kit
        if own is not None and not layout.alike(own, belief):
            own = None
        with_own = kit_belief(replace(hints, kit=product([hints.kit, own])))
        m, start = window.from_prediction(prediction, hints, with_own.mean)
        ties = rig_ties(m)
        with _solvable():
            solved = solution.solved(start, m, ties, belief, hints, with_own, solution.HELD)
        solved = window.with_known_offset(solved, hints)
        return replace(solved, kit_sigma=prediction.kit_sigma)

    def locate_view(
        self,
        images: Sequence[NDArray[np.uint8]],
        hints: Hints,
        prediction: Prediction,
        camera: Camera,
    ) -> Float | None:
        """Pose (4, 4) of the last image, of another camera, by the points of the others."""
        tracks = loop_view.match_loop(images, hints, prediction.cameras, camera)
        found = loop_view.locate(prediction.cameras, prediction.T_s_c, tracks, camera)
        return None if found is None else found.T_s_c

    def densify(
        self, images: Sequence[NDArray[np.uint8]], hints: Hints, prediction: Prediction
    ) -> Prediction:
        """The prediction with plane-sweep depth and confidence (depth.py)."""
        if prediction.depth is not None:
            return prediction
        # `record` solves poses only and does not load this
        from calm_edge.backbones.bundle.depth import sweep_window

        depth, confidence = sweep_window(images, hints, prediction, *self._depth)
        return replace(prediction, depth=depth, confidence=confidence)


def kit_beliefs(hints: Hints) -> dict[layout.Families, KitBelief]:
    """Priors on the kit by the families that its lenses may be of: all where nothing is known."""
    known, own = (False, False), layout.PERSPECTIVE
    if hints.kit is not None:
        known, own = layout.of_lens(hints.kit), layout.families(hints.kit.mean)
    return {
        families: kit_belief(hints, families)
        for families in FAMILIES
        if all(a is b or not k for a, b, k in zip(families, own, known, strict=True))
    }


def kit_belief(hints: Hints, families: layout.Families | None = None) -> KitBelief:
    """Prior on the kit: product of the layout's, with the hints, and hints.kit.

    families: of the lenses, None: as of hints.kit, or perspective. The time offset is what is left
    of it after the known offsets of the stamps.
    """
    if families is None:
        families = layout.PERSPECTIVE if hints.kit is None else layout.families(hints.kit.mean)
    prior = layout.prior(hints.hfov_deg, hints.sizes, hints.readout_s, families)
    prior = layout.with_time_jitter(prior, hints.late_sigma_s)
    joint = product([prior, hints.kit])
    assert joint is not None
    length = np.linalg.norm(joint.mean[layout.RIG_CENTRE])
    if length > 1e-6:
        joint.mean[layout.RIG_CENTRE] /= length
    return joint


def _solved_on_road(
    every: Measurements, solved: Prediction, images: Sequence[NDArray[np.uint8]], hints: Hints
) -> Prediction | None:
    """Solve a window of doubtful scale again with points of the road; None if these do not help."""
    known = kit_belief(replace(hints, kit=product([hints.kit, solved.kit])))
    state = State(se3.inverse(solved.T_s_c), np.zeros((0, 4)), known.mean)
    gray = [
        np.asarray(cv2.cvtColor(images[k], cv2.COLOR_BGR2GRAY), np.uint8)
        for k in window.split_eyes(hints)[0]
    ]
    with suppress(BackboneError), _solvable():
        found = with_road(every, state, gray, hints.travel)
        if found is None:
            return None
        m, start = found
        belief = kit_belief(hints, layout.families(known.mean))
        again = solution.solved(start, m, rig_ties(m), belief, hints, belief, solution.FREE)
        surer = again.kit is not None and _scale_sigma(again) < _scale_sigma(solved)
        # a speed that the previous window contradicts may be a pattern of the road
        if surer and (_agrees(again) or not _agrees(solved)):
            return again
    return None


def _agrees(solved: Prediction) -> bool:
    """Whether a window does not contradict the previous one, if it shares keyframes with one."""
    return (solved.overlap_mismatch or 0.0) <= solution.MAX_MISMATCH


def _scale_sigma(solved: Prediction) -> float:
    sigma = solved.scale_log_sigma
    return np.inf if sigma is None else sigma


def _apart(m: Measurements, belief: KitBelief, hints: Hints) -> Float | None:
    if not hints.apart:
        return None
    try:
        with _solvable():
            return solved_apart(m, hints.travel, solution.stiffened(belief, solution.HELD))
    except BackboneError:
        return None


@contextmanager
def _solvable() -> Iterator[None]:
    """Translate failures of numpy, OpenCV and camera models to BackboneError."""
    try:
        yield
    except FieldTooWide as error:
        raise BackboneError(f"bundle: {error}") from None
    except (np.linalg.LinAlgError, cv2.error):
        raise BackboneError(
            "bundle: the pictures do not determine their poses (too few matches?)"
        ) from None
