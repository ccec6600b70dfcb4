"""Solve and rectify a window, with the drive's belief on the kit and its time offset."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from calm_edge.backbones.base import Backbone, BackboneError, ResolvingBackbone
from calm_edge.config import Config
from calm_edge.estimator import scale, window_submap
from calm_edge.estimator.direction_memory import DirectionMemory
from calm_edge.estimator.ego_masks import EgoMasks
from calm_edge.estimator.judgement import judge
from calm_edge.estimator.kit_memory import KitMemory
from calm_edge.estimator.kit_watch import KitWatch
from calm_edge.estimator.known_lenses import KnownLenses
from calm_edge.estimator.loop_closing import LoopClosing
from calm_edge.estimator.metre import DriveMetre
from calm_edge.estimator.rectifier import Rectifier
from calm_edge.estimator.stage_time import timed
from calm_edge.estimator.stamp_correction import StampCorrection
from calm_edge.geometry.alike import look_alike
from calm_edge.kit import change, layout
from calm_edge.kit.prior import KitPrior
from calm_edge.types import (
    Bytes,
    Float,
    Hints,
    KitBelief,
    LoopClosure,
    Prediction,
    Submap,
    SubmapWindow,
)

ALIKE = "both pictures look alike"


@dataclass(frozen=True, slots=True)
class Reconstruction:
    """A solved window that is not yet placed.

    Without a loop view if `closed` is None. recalibrated: the sub-maps before it have to be
    rectified again.
    """

    window: SubmapWindow
    hints: Hints
    prediction: Prediction
    submap: Submap
    closed: LoopClosure | None
    recalibrated: bool


class WindowSolver:
    """Solves windows with the drive's memories, which its owner updates with what is solved.

    lenses: None if pictures are not undistorted. retimed: called when the estimate of the
    assistant's time offset was corrected.
    """

    def __init__(
        self,
        config: Config,
        backbone: Backbone,
        *,
        memory: KitMemory,
        kit_prior: KitPrior,
        rectifier: Rectifier,
        loops: LoopClosing,
        direction: DirectionMemory,
        metre: DriveMetre,
        watch: KitWatch,
        stamps: StampCorrection,
        ego: EgoMasks,
        lenses: KnownLenses | None,
        retimed: Callable[[], None],
    ) -> None:
        self._config, self._backbone = config, backbone
        self._memory, self._kit_prior, self._rectifier = memory, kit_prior, rectifier
        self._loops, self._direction, self._metre = loops, direction, metre
        self._watch, self._stamps, self._retimed = watch, stamps, retimed
        self._ego, self._lenses = ego, lenses

    def solved(
        self, window: SubmapWindow, sources: Sequence[Submap], stage_ms: dict[str, float]
    ) -> tuple[Reconstruction, bool]:
        """Solve a window, with the rig free if it does not fit the belief on the kit.

        Returns whether it contradicts the belief. Raises as `reconstructed`.
        """
        sigma, evidence = self.kit_sigma(window.submap_id), self._memory.evidence()
        belief = self._memory.belief()
        if sigma is None or sigma[0] >= layout.RIG_KNOWN_RAD or belief is None:
            return self.reconstructed(window, sources, stage_ms), False
        solved, failure = None, BackboneError("")
        try:
            solved = self.reconstructed(window, sources, stage_ms)
        except BackboneError as error:
            failure = error
        if solved is None or not KitWatch.fits(evidence, solved.prediction):
            with suppress(BackboneError, scale.ScaleError):
                free = self.reconstructed(window, sources, stage_ms, kit=change.without_rig(belief))
                if free.prediction.kit is not None:
                    if not KitWatch.fits(evidence, free.prediction):
                        return free, True
                    solved = free
        if solved is None:
            raise failure
        if solved.prediction.kit is not None:
            self._watch.acquit()
        return solved, False

    def reconstructed(
        self,
        window: SubmapWindow,
        sources: Sequence[Submap],
        stage_ms: dict[str, float],
        *,
        known: bool = False,
        loops: bool = True,
        kit: KitBelief | None = None,
    ) -> Reconstruction:
        """Solve and rectify a window; raises BackboneError, ScaleError, UnreadableImage.

        sources: the drive's sub-maps so far. known: it has a sub-map already. loops: search a loop.
        kit: instead of the belief.
        """
        window, candidate = self._loops.allowed(window), None
        with timed(stage_ms, "decode"):
            images = [keyframe.frame.bgr() for keyframe in window.keyframes()]
        self._refuse_alike(window, images)
        if loops:
            with timed(stage_ms, "loop"):
                window, images, candidate = self._loops.with_loop(window, images)
        with timed(stage_ms, "infer"):
            prediction, hints = self._inferred(window, images, kit)
        raw = window_submap.raw_submap(window, hints, prediction)
        raw = replace(raw, kit_epoch=self._memory.epoch(window.submap_id))
        recalibrated = False
        if not known:
            with timed(stage_ms, "search"):
                recalibrated = self._rectifier.update(raw, prediction.landmarks, images)
        with timed(stage_ms, "rectify"):
            submap = self._rectifier.rectify(raw)
        judge(submap, self._config.scale.spacing)
        if not known:
            with timed(stage_ms, "mask"):
                self._learn_masks(window, images, hints, prediction)
            if self._lenses is not None:
                with timed(stage_ms, "lens"):
                    self._lenses.learn(images, hints, prediction)
        closed = self._loops.closure(window, submap, prediction, candidate, sources)
        if window.loop_keyframe is not None and closed is None:
            if known:
                raise BackboneError("bundle: the loop keyframe could not be placed again")
            window = replace(window, loop_keyframe=None)
            prediction, submap = prediction.without_loop(), submap.without_loop()
            hints = hints.without_loop()
        return Reconstruction(window, hints, prediction, submap, closed, recalibrated)

    def _refuse_alike(self, window: SubmapWindow, images: Sequence[Bytes]) -> None:
        """Raise ScaleError if both cameras deliver the same pictures."""
        n, m = len(window.primary), len(window.assistant)
        alike = look_alike(images[:n], images[n : n + m])
        self._metre.object_to("pictures", ALIKE if alike else None)
        if alike:
            raise scale.ScaleError(ALIKE)

    def _learn_masks(
        self, window: SubmapWindow, images: list[Bytes], hints: Hints, prediction: Prediction
    ) -> None:
        """Learn what is attached to the car."""
        n = len(window.primary)
        eyes = np.asarray(hints.eyes)[: n + len(window.assistant)]
        cameras = [prediction.cameras[0], prediction.cameras[n if len(eyes) > n else 0]]
        self._ego.add(window.submap_id, images, eyes, cameras, prediction.T_s_c)

    def _inferred(
        self, window: SubmapWindow, images: list[Bytes], kit: KitBelief | None
    ) -> tuple[Prediction, Hints]:
        """Solve a window; a second time if it shows that the assistant's stamps are wrong.

        kit: belief to use, None for that of the drive so far.
        """

        def hinted() -> Hints:
            hints = self._hints(window, images)
            return hints if kit is None else replace(hints, kit=kit)

        hints, failure = hinted(), None
        try:
            prediction = self._backbone.infer(images, hints)
            apart = prediction.T_s_c_apart
        except BackboneError as error:
            apart, failure = error.T_s_c_apart, error
        corrected = self._stamps.add(window.submap_id, hints, apart)
        self._metre.object_to("stamps", self._stamps.objection)
        if corrected:
            self._retimed()
            # the window before was solved with the wrong stamps
            hints = hinted().without_neighbours()
            prediction = self._backbone.infer(images, hints)
        elif failure is not None:
            raise failure
        return prediction, hints

    def kit_sigma(self, submap_id: int) -> Float | None:
        """`kit_sigma` for solving this window now; None if the backbone estimates no kit."""
        if not isinstance(self._backbone, ResolvingBackbone):
            return None
        nothing = np.zeros(0, np.int64)
        kit = self._memory.belief(without=submap_id)
        hints = Hints(nothing, nothing, self._config.backbone.hfov_of_eye, kit)
        return self._backbone.kit_sigma(hints)

    def _hints(self, window: SubmapWindow, images: list[Bytes]) -> Hints:
        frames = [keyframe.frame for keyframe in window.keyframes()]
        sizes = window_submap.sizes(window, images)
        if self._memory.resized(window.submap_id, sizes):
            self._kit_prior.forget(lens=True)
            self._watch.acquit()
        self._kit_prior.open(self._memory.sizes)
        self._ego.remember(self._kit_prior.ego)
        self._memory.prior = self._kit_prior.belief
        hints = Hints(
            eyes=np.array([frame.eye for frame in frames], np.int64),
            t_ns=np.array([frame.t_ns for frame in frames], np.int64),
            hfov_deg=self._config.backbone.hfov_of_eye,
            kit=self._memory.belief(without=window.submap_id),
            readout_s=self._config.capture.readout_s_of_eye,
            sizes=sizes,
            loop=window.loop_keyframe is not None,
            n_overlap=window.n_overlap,
            overlap=self._memory.overlap_before(window.submap_id),
            n_shared=self._config.overlap_shared,
            apart=self._stamps.wanted(window.submap_id),
            travel=self._direction.direction,
            masks=self._ego.masks,
            lenses=(None, None) if self._lenses is None else self._lenses.of(sizes),
        )
        return replace(
            hints,
            late_s=self._stamps.late_s(hints),
            late_sigma_s=self._stamps.sigma_s,
            lengths=self._memory.lengths_beside(window.submap_id, hints),
        )
