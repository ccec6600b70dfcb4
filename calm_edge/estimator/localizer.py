"""Compute a trajectory from windows: sections IV and V of the paper in order.

Differences from the paper: the unit is the spacing itself (scale.py); windows solved with an
outdated belief on the kit are solved again (kit_memory.py), from their pictures if these were
matched before the kit was known (held_windows.py); windows that cannot be reconstructed are bridged
(atlas.py).
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace
from time import perf_counter

import numpy as np

from calm_edge.backbones.base import Backbone, BackboneError, ResolvingBackbone
from calm_edge.backbones.undistorted import UndistortedPictures
from calm_edge.config import Config
from calm_edge.estimator import gaps, scale, window_submap
from calm_edge.estimator.atlas import Atlas, SkippedWindow
from calm_edge.estimator.direction_memory import DirectionMemory
from calm_edge.estimator.ego_masks import EgoMasks
from calm_edge.estimator.held_windows import HeldWindows, unsettled
from calm_edge.estimator.kit_memory import KitMemory, lost_scale
from calm_edge.estimator.kit_watch import KitWatch, Slip, Suspect
from calm_edge.estimator.known_lenses import KnownLenses
from calm_edge.estimator.loop_closing import LoopClosing
from calm_edge.estimator.metre import ALONE, DriveMetre
from calm_edge.estimator.rectifier import Rectifier
from calm_edge.estimator.replacement import Replacements
from calm_edge.estimator.stage_time import timed
from calm_edge.estimator.stamp_correction import StampCorrection
from calm_edge.estimator.window_solver import Reconstruction, WindowSolver
from calm_edge.kit import layout
from calm_edge.kit.belief import product
from calm_edge.kit.given_mask import masks_of
from calm_edge.kit.prior import KitPrior
from calm_edge.loops.descriptor import descriptor_of
from calm_edge.loops.finder import LoopFinder, PlaceLoops
from calm_edge.posegraph.optimiser import Immediate, Optimiser
from calm_edge.types import (
    Float,
    GlobalIntrinsics,
    Hints,
    Int,
    KitBelief,
    LocalizerUpdate,
    Masks,
    Metre,
    Prediction,
    Submap,
    SubmapWindow,
    Trajectory,
)
from device.frame import UnreadableImage

log = logging.getLogger(__name__)

# Sub-maps placed again per window, so that its cost does not grow with the drive.
REPLACED_PER_WINDOW = 8
# At the end of a drive all windows are solved again, and then, at most so many times, those whose
# focal has moved since.
RELINEARISED = 2


class Localizer:
    """Computes placed sub-maps from windows, in order; deterministic, given the windows.

    loops: finder of loop closures (IV-D), by default as configured. optimiser: computes the joint
    optimum; if in another process, the result is applied with a later window. unhurried: `process`
    also solves a window again from its pictures if one is due; else `solve_again` does it.
    """

    def __init__(
        self,
        config: Config,
        backbone: Backbone,
        loops: LoopFinder | None = None,
        optimiser: Optimiser | None = None,
        *,
        unhurried: bool = True,
    ) -> None:
        self._config = config
        self._backbone = backbone
        self._memory = KitMemory(backbone, config.backbone.resolve_windows)
        self._kit_prior = KitPrior(config)
        estimates_kit = isinstance(backbone, ResolvingBackbone)
        undistorts = isinstance(backbone, UndistortedPictures)
        self._lenses = KnownLenses(config, self._kit_prior) if undistorts else None
        self._rectifier = Rectifier(config, estimates_kit)
        if loops is None and config.loops.enabled:
            descriptor = descriptor_of(backbone, config.loops.descriptor)
            loops = PlaceLoops(config.loops, descriptor)
        self._optimiser = optimiser or Immediate()
        self._atlas = Atlas(config)
        self._loops = LoopClosing(loops, self._atlas, config.scale.spacing)
        self._replacements = Replacements(self._atlas, self._rectifier)
        self._direction = DirectionMemory()
        self._metre = DriveMetre(config.scale.spacing)
        self._optimised = False
        self._noticed: set[str] = set()
        self._unhurried = unhurried
        self._held = HeldWindows()
        # ids of sub-maps solved again from pictures; of those restored in their final solution
        self._again: set[int] = set()
        self._restored: set[int] = set()
        self._told_epoch = 0
        self._watch = KitWatch()
        self._stamps = StampCorrection()
        self._ego = EgoMasks(masks_of(config.capture))
        self._retimed = False
        self._solver = WindowSolver(
            config,
            backbone,
            memory=self._memory,
            kit_prior=self._kit_prior,
            rectifier=self._rectifier,
            loops=self._loops,
            direction=self._direction,
            metre=self._metre,
            watch=self._watch,
            stamps=self._stamps,
            ego=self._ego,
            lenses=self._lenses,
            retimed=self._retime,
        )

    @property
    def submaps(self) -> tuple[Submap, ...]:
        """All sub-maps with their current poses."""
        return self._atlas.submaps

    @property
    def skipped(self) -> tuple[SkippedWindow, ...]:
        """Windows that were not reconstructed; the n_overlap of the following sub-map is 0."""
        return self._atlas.skipped

    @property
    def metre(self) -> Metre:
        """How well the drive's lengths are known so far, given the spacing."""
        return self._metre.of(self._atlas.submaps)

    @property
    def gaps(self) -> tuple[gaps.Gap, ...]:
        """Gaps of the path that no picture and no loop connects."""
        return self._atlas.gaps

    @property
    def intrinsics(self) -> GlobalIntrinsics | None:
        """Result of the online intrinsic search (V-A), if it runs."""
        return self._rectifier.intrinsics

    @property
    def solved_again(self) -> dict[int, Prediction]:
        """Newest solutions, by sub-map id, of windows solved again from their pictures."""
        found = {submap_id: self._memory.prediction(submap_id) for submap_id in self._again}
        return {submap_id: each for submap_id, each in found.items() if each is not None}

    @property
    def kit(self) -> KitBelief | None:
        """Belief on the kit, of earlier drives and this one."""
        return self._memory.belief()

    @property
    def masks(self) -> Masks | None:
        """Parts of the pictures that show no scene, as known now; None if there are none."""
        return self._ego.masks

    def process(self, window: SubmapWindow) -> LocalizerUpdate | None:
        """Process a window; None if it could not be reconstructed (see `skipped`)."""
        atlas, stage_ms = self._atlas, dict[str, float]()
        sigma = self.kit_sigma(window.submap_id)
        evidence = self._memory.evidence()
        try:
            solved, suspected = self._solver.solved(window, self._replacements.sources, stage_ms)
        except (BackboneError, scale.ScaleError, UnreadableImage) as error:
            self._skip(window, str(error))
            if sigma is not None:
                self._held.hold(window, sigma)
            return None
        window, prediction, closed = solved.window, solved.prediction, solved.closed
        with timed(stage_ms, "place"):
            atlas.add(solved.submap)
            path = solved.submap.T_s_c[: solved.submap.n_primary]
            self._direction.add(path, self._config.scale.spacing)
            self._loops.remember(window)
            # nothing has tested a first window of an unknown kit until a second one agrees
            tested = len(atlas) > 1 or sigma is None or bool(np.all(sigma < layout.KIT_KNOWN))
            self._metre.object_to("first window", None if tested else ALONE)
        with timed(stage_ms, "resolve"):
            lines = prediction.notices
            if suspected and evidence is not None:
                # its evidence counts only if the kit has changed
                self._memory.add(window.submap_id, replace(prediction, kit=None), solved.hints)
                stamp = int(solved.submap.t_ns[0])
                suspect = Suspect(window.submap_id, stamp, prediction, solved.hints)
                slip = self._watch.suspect(suspect, evidence)
                lines += () if slip is None else self._slipped(slip)
            else:
                self._memory.add(window.submap_id, prediction, solved.hints)
            if sigma is not None and unsettled(prediction):
                self._held.hold(window, sigma)
            lines += self._kit_prior.contradicted(self._evidence)
            lines += () if self._lenses is None else self._lenses.notices
            lines += (self._stamps.notice,) if self._stamps.notice else ()
            lines += self._ego.notices
            notices = self._new_notices(lines)
            self._memory.prior = self._kit_prior.belief
            self._replacements.stale |= solved.recalibrated
            if self._replacements.due:
                self._replacements.begin(atlas.submaps)
            if self._retimed:
                self._retimed = False
                self._resolve(self._memory.correct_stamps(self._stamps.late_s_or_zero))
            self._resolve(self._memory.outdated())
            if self._unhurried:
                self.solve_again()
            self._replace(REPLACED_PER_WINDOW)
        with timed(stage_ms, "optimise"):
            if closed is not None:
                atlas.add_loop(closed)
                self._request()
            atlas.settle(self._optimiser)
        placed, moved = atlas.submaps[-1], atlas.epoch != self._told_epoch
        self._told_epoch = atlas.epoch
        return LocalizerUpdate(
            submap=placed,
            prediction=prediction,
            trajectory=atlas.trajectory() if moved else atlas.trajectory_of(placed),
            stage_ms=stage_ms,
            kit=self._memory.belief(),
            notices=notices,
            loop=closed,
            loop_keyframe=window.loop_keyframe if closed is not None else None,
            metre=self.metre,
            masks=self.masks,
        )

    def leave_out(self, submap_id: int, t_ns: Int) -> None:
        """Record a window that is not to be processed. t_ns: (N,) of its primary keyframes."""
        self._atlas.skip(SkippedWindow(submap_id, "left out", t_ns))

    def solve_again(self, *, final: bool = False) -> bool:
        """Solve a held window again from its pictures; False if none is worth it.

        final: no more windows will follow.
        """

        def sigma_now(submap_id: int) -> Float:
            sigma = self.kit_sigma(submap_id)
            assert sigma is not None
            return sigma

        window = self._held.next(sigma_now, final=final)
        if window is not None:
            self.attempt(window, loops=False)
        return window is not None

    def attempt(self, window: SubmapWindow, *, loops: bool = True) -> Reconstruction | None:
        """Solve a window from its pictures, with all that is known; None if that fails.

        For windows that `process` or `restore` has had, and for those that neither has: the sub-map
        is inserted in order. What is solved is placed with a later window or by `finish`. loops:
        search a loop for a window without a sub-map.
        """
        submap_id, sources = window.submap_id, self._replacements.sources
        known = submap_id in {submap.id for submap in sources}
        sigma = self.kit_sigma(submap_id)
        if sigma is not None:
            self._held.hold(window, sigma)
        try:
            solved = self._solver.reconstructed(
                window, sources, {}, known=known, loops=loops and not known
            )
        except (BackboneError, scale.ScaleError, UnreadableImage) as error:
            log.warning("sub-map %d not solved again: %s", submap_id, error)
            return None
        earlier, prediction = self._memory.prediction(submap_id), solved.prediction
        if earlier is not None and (
            (earlier.kit is not None and prediction.kit is None) or lost_scale(earlier, prediction)
        ):
            return None
        if not unsettled(prediction):
            self._held.drop(submap_id)
        self._memory.add(submap_id, prediction, solved.hints)
        self._again.add(submap_id)
        self._restored.discard(submap_id)
        if known:
            raw = [
                window_submap.solved_again(s, prediction if s.id == submap_id else None)
                for s in sources
            ]
        else:
            self._atlas.unskip(submap_id)
            raw = sorted([*sources, solved.submap], key=lambda submap: submap.id)
            self._loops.remember(solved.window)
            if solved.closed is not None:
                self._atlas.add_loop(solved.closed)
        self._replacements.begin(raw)
        return solved

    def restore(self, update: LocalizerUpdate, hints: Hints, *, final: bool) -> None:
        """Take over a sub-map that was solved earlier, in order; raises ScaleError.

        hints: for solving it again. final: `finish` has been called since it was solved. Only for a
        backbone that estimates the kit: the intrinsic search learns nothing from it.
        """
        if update.submap.kit_epoch > self._memory.epoch(None):
            self._memory.begin_epoch(update.submap.id, None)
        self._atlas.add(self._rectifier.rectify(update.submap))
        self._ego.restore(update.masks)
        self._memory.add(update.submap.id, update.prediction, hints)
        if update.loop is not None:
            self._atlas.add_loop(update.loop)
        if final:
            self._restored.add(update.submap.id)

    def remember(self, window: SubmapWindow) -> None:
        """Make the keyframes of a restored window places of the loop search."""
        self._loops.restore(window)

    def finish(self, limit_s: float = np.inf) -> Trajectory | None:
        """Solve all windows with the final belief, then the joint optimum; None without sub-map.

        limit_s: for solving windows again from their pictures.
        """
        end_s = perf_counter() + limit_s
        self._optimiser.close()
        self._optimiser = Immediate()
        if not len(self._atlas):
            return None
        self._metre.object_to("first window", None)
        if self._rectifier.finish() or self._replacements.stale:
            self._replacements.begin(self._replacements.sources)
        while perf_counter() < end_s and self.solve_again(final=True):
            pass
        outdated = {*self._memory.retained()} - self._restored | {*self._memory.outdated()}
        self._resolve(sorted(outdated))
        for _ in range(RELINEARISED):
            self._resolve(self._memory.outdated())
        self._replace()
        self._request()
        self._atlas.settle(self._optimiser)
        if self.metre.metric:
            self._kit_prior.save(self._evidence, self._ego.log_odds)
        return self.trajectory()

    def kit_sigma(self, submap_id: int) -> Float | None:
        """`kit_sigma` for solving this window now; None if the backbone estimates no kit."""
        return self._solver.kit_sigma(submap_id)

    def trajectory(self) -> Trajectory:
        """All primary keyframes that have a pose, sorted by id."""
        return self._atlas.trajectory()

    @property
    def _evidence(self) -> KitBelief | None:
        """What this drive has shown of the kit, by whichever backbone."""
        return self._memory.evidence() if self._lenses is None else self._lenses.evidence

    def _retime(self) -> None:
        """The time offset was corrected: windows solved before had wrong stamps."""
        self._held.forget_attempts()
        self._retimed = True

    def _slipped(self, slip: Slip) -> tuple[str, ...]:
        """Begin a new epoch of the kit; return the line for the user."""
        first = slip.suspects[0]
        known = self._kit_prior.forget(lens=False)
        self._memory.begin_epoch(first.submap_id, product([slip.carried, known]))
        for suspect in slip.suspects:
            self._memory.add(suspect.submap_id, suspect.prediction, suspect.hints)
            self._again.add(suspect.submap_id)
        epoch = self._memory.epoch(None)
        self._replacements.begin(
            [
                replace(s, kit_epoch=epoch if s.id >= first.submap_id else s.kit_epoch)
                for s in self._replacements.sources
            ]
        )
        after_s = (first.t_ns - int(self._atlas.submaps[0].t_ns[0])) // 1_000_000_000
        when = f"{after_s // 60}:{after_s % 60:02d}"
        return (
            f"the kit changed {when} into the drive: {slip.text}; it is learned again from there",
        )

    def _new_notices(self, lines: Sequence[str]) -> tuple[str, ...]:
        """Select the lines that have not been reported yet in this drive."""
        new = tuple(line for line in dict.fromkeys(lines) if line not in self._noticed)
        self._noticed.update(new)
        return new

    def _skip(self, window: SubmapWindow, reason: str) -> None:
        log.warning("sub-map %d skipped: %s", window.submap_id, reason)
        t_ns = np.array([keyframe.frame.t_ns for keyframe in window.primary], np.int64)
        self._atlas.skip(SkippedWindow(window.submap_id, reason, t_ns))

    def _resolve(self, submap_ids: list[int]) -> None:
        """Solve windows again with the current belief; then all sub-maps are placed again."""
        solved = self._memory.resolve(submap_ids)
        if solved:
            raw = [
                window_submap.solved_again(s, solved.get(s.id)) for s in self._replacements.sources
            ]
            self._replacements.begin(raw)

    def _replace(self, most: int | None = None) -> None:
        """Place up to `most` further sub-maps again, None for all."""
        if self._replacements.advance(most) and self._optimised:
            self._request()

    def _request(self) -> None:
        if self._config.posegraph.optimise:
            self._atlas.request_optimum(self._optimiser)
            self._optimised = True
