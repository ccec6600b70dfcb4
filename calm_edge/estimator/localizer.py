"""Compute a trajectory from windows: sections IV and V of the paper in order.

Differences from the paper: the unit is the spacing itself (scale.py); windows solved with an
outdated belief on the kit are solved again (kit_memory.py); windows that cannot be reconstructed
are bridged (atlas.py).
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from time import perf_counter

import numpy as np

from calm_edge.backbones.base import Backbone, BackboneError, ResolvingBackbone
from calm_edge.config import Config
from calm_edge.estimator import scale, window_submap
from calm_edge.estimator.atlas import Atlas, SkippedWindow
from calm_edge.estimator.kit_memory import KitMemory
from calm_edge.estimator.metre import DriveMetre
from calm_edge.estimator.rectifier import Rectifier
from calm_edge.estimator.replacement import Replacement
from calm_edge.geometry import se3
from calm_edge.kit.prior import KitPrior
from calm_edge.loops.descriptor import descriptor_of
from calm_edge.loops.finder import LoopCandidate, LoopFinder, PlaceLoops
from calm_edge.loops.same_place import KnownKit
from calm_edge.posegraph.optimiser import Immediate, Optimiser
from calm_edge.types import (
    Bytes,
    GlobalIntrinsics,
    Hints,
    Int,
    LocalizerUpdate,
    LoopClosure,
    Metre,
    Prediction,
    Submap,
    SubmapWindow,
    Trajectory,
)
from device.frame import UnreadableImage

log = logging.getLogger(__name__)

# All sub-maps are rectified and placed again, if the calibration has changed, once their number has
# grown by this factor since the last time: calibration changes little late in a drive.
REPLACE_GROWTH = 1.1
# Sub-maps placed again per window, so that its cost does not grow with the drive.
REPLACED_PER_WINDOW = 8


class Localizer:
    """Computes placed sub-maps from windows, in order; deterministic, given the windows.

    loops: finder of loop closures (IV-D), by default as configured. optimiser: computes the joint
    optimum; if in another process, the result is applied with a later window.
    """

    def __init__(
        self,
        config: Config,
        backbone: Backbone,
        loops: LoopFinder | None = None,
        optimiser: Optimiser | None = None,
    ) -> None:
        self._config = config
        self._backbone = backbone
        self._memory = KitMemory(backbone, config.backbone.resolve_windows)
        self._kit_prior = KitPrior(config)
        self._rectifier = Rectifier(config, isinstance(backbone, ResolvingBackbone))
        self._loops = loops
        if loops is None and config.loops.enabled:
            descriptor = descriptor_of(backbone, config.loops.descriptor)
            self._loops = PlaceLoops(config.loops, descriptor)
        self._optimiser = optimiser or Immediate()
        self._atlas = Atlas(config)
        self._metre = DriveMetre(config.scale.spacing)
        self._optimised = False
        self._stale = False
        self._n_replaced = 0
        self._replacement: Replacement | None = None
        self._noticed: set[str] = set()

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
    def intrinsics(self) -> GlobalIntrinsics | None:
        """Result of the online intrinsic search (V-A), if it runs."""
        return self._rectifier.intrinsics

    def process(self, window: SubmapWindow) -> LocalizerUpdate | None:
        """Process a window; None if it could not be reconstructed (see `skipped`)."""
        atlas, stage_ms = self._atlas, dict[str, float]()
        epoch = atlas.epoch
        if self._loops is None:
            window = replace(window, loop_keyframe=None)
        try:
            with _timed(stage_ms, "decode"):
                images = [keyframe.frame.bgr() for keyframe in window.keyframes()]
            with _timed(stage_ms, "loop"):
                window, images, candidate = self._with_loop(window, images)
            hints = self._hints(window, images)
            with _timed(stage_ms, "infer"):
                prediction = self._backbone.infer(images, hints)
            raw = window_submap.raw_submap(window, hints, prediction)
            with _timed(stage_ms, "search"):
                recalibrated = self._rectifier.update(raw, prediction.landmarks, images)
            with _timed(stage_ms, "rectify"):
                submap = self._rectifier.rectify(raw)
        except (BackboneError, scale.ScaleError, UnreadableImage) as error:
            self._skip(window, str(error))
            return None
        closed = self._closure(window, submap, prediction, candidate)
        if window.loop_keyframe is not None and closed is None:
            prediction, submap = prediction.without_loop(), submap.without_loop()
            hints = hints.without_loop()
        with _timed(stage_ms, "place"):
            atlas.add(submap)
            if self._loops is not None:
                self._loops.remember(window)
        with _timed(stage_ms, "resolve"):
            self._memory.add(submap.id, prediction, hints)
            changed = self._kit_prior.contradicted(self._memory.evidence())
            notices = self._new_notices((*prediction.notices, *changed))
            self._memory.prior = self._kit_prior.belief
            self._stale |= recalibrated
            grown = len(atlas) >= REPLACE_GROWTH * self._n_replaced
            if self._stale and grown and self._replacement is None:
                self._begin_replacement(atlas.submaps)
            self._resolve(self._memory.outdated())
            self._replace(REPLACED_PER_WINDOW)
        with _timed(stage_ms, "optimise"):
            if closed is not None:
                atlas.add_loop(closed)
                self._request()
            atlas.settle(self._optimiser)
        placed, moved = atlas.submaps[-1], atlas.epoch != epoch
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
        )

    def leave_out(self, submap_id: int, t_ns: Int) -> None:
        """Record a window that is not to be processed. t_ns: (N,) of its primary keyframes."""
        self._atlas.skip(SkippedWindow(submap_id, "left out", t_ns))

    def finish(self) -> Trajectory | None:
        """Solve all windows with the final belief, then the joint optimum; None without sub-map."""
        self._optimiser.close()
        self._optimiser = Immediate()
        if not len(self._atlas):
            return None
        if self._rectifier.finish() or self._stale:
            self._begin_replacement(self._sources())
        self._resolve(self._memory.retained())
        self._replace()
        self._request()
        self._atlas.settle(self._optimiser)
        self._kit_prior.save(self._memory.evidence())
        return self.trajectory()

    def trajectory(self) -> Trajectory:
        """All primary keyframes that have a pose, sorted by id."""
        return self._atlas.trajectory()

    def _hints(self, window: SubmapWindow, images: list[Bytes]) -> Hints:
        frames = [keyframe.frame for keyframe in window.keyframes()]
        sizes = window_submap.sizes(window, images)
        self._kit_prior.open(sizes)
        self._memory.prior = self._kit_prior.belief
        return Hints(
            eyes=np.array([frame.eye for frame in frames], np.int64),
            t_ns=np.array([frame.t_ns for frame in frames], np.int64),
            hfov_deg=self._config.backbone.hfov_of_eye,
            kit=self._memory.belief(),
            sizes=sizes,
            loop=window.loop_keyframe is not None,
        )

    def _with_loop(
        self, window: SubmapWindow, images: list[Bytes]
    ) -> tuple[SubmapWindow, list[Bytes], LoopCandidate | None]:
        """Append an earlier image of the same place to the batch, if one is found (IV-D).

        A window from a recording that has a loop keyframe keeps it, unless loops are disabled.
        """
        if self._loops is None:
            return window, images, None
        candidate = self._loops.find(window, images, self._known_kit())
        if candidate is None or window.loop_keyframe is not None:
            return window, images, None
        joined = replace(window, loop_keyframe=candidate.keyframe)
        return joined, [*images, candidate.keyframe.frame.bgr()], candidate

    def _known_kit(self) -> KnownKit | None:
        if not len(self._atlas):
            return None
        newest = self._atlas.submaps[-1]
        cameras = newest.cameras[0], newest.cameras[newest.n_primary]
        return KnownKit(cameras, self._atlas.T_p_a)

    def _closure(
        self,
        window: SubmapWindow,
        submap: Submap,
        prediction: Prediction,
        candidate: LoopCandidate | None,
    ) -> LoopClosure | None:
        """Loop closure with the pose that the backbone computed for the loop keyframe.

        None if there is no such keyframe or pose, or if the pose disagrees with the approximate one
        of the candidate, from matches of the two images.
        """
        match = window.loop_keyframe
        if match is None or not prediction.loop_found or match.id not in self._atlas:
            return None
        T_s_match = submap.T_s_c[-1]
        apart = np.linalg.norm(submap.T_s_c[: submap.n_primary, :3, 3] - T_s_match[:3, 3], axis=1)
        query = candidate.query_view if candidate is not None else int(apart.argmin())
        T_match_query = se3.inverse(T_s_match) @ submap.T_s_c[query]
        spacing = self._config.scale.spacing
        if candidate is not None and not candidate.agrees(se3.inverse(T_match_query), spacing):
            log.info("sub-map %d: loop closure with keyframe %d rejected", submap.id, match.id)
            return None
        return LoopClosure(submap.primary_ids[query], match.id, T_match_query)

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
            raw = [window_submap.solved_again(s, solved.get(s.id)) for s in self._sources()]
            self._begin_replacement(raw)

    def _sources(self) -> tuple[Submap, ...]:
        """All sub-maps with their newest raw poses, also those not yet placed again."""
        return self._replacement.sources if self._replacement else self._atlas.submaps

    def _begin_replacement(self, submaps: Sequence[Submap]) -> None:
        """Begin to rectify the sub-maps from their raw poses and to place them again."""
        self._stale, self._n_replaced = False, len(submaps)
        calibration = self._rectifier.calibration
        rectify = partial(self._rectifier.rectify, calibration=calibration)
        self._replacement = Replacement(self._atlas, submaps, rectify)

    def _replace(self, most: int | None = None) -> None:
        """Place up to `most` further sub-maps again, None for all."""
        if self._replacement is not None and self._replacement.advance(most):
            self._replacement = None
            if self._optimised:
                self._request()

    def _request(self) -> None:
        if self._config.posegraph.optimise:
            self._atlas.request_optimum(self._optimiser)
            self._optimised = True


@contextmanager
def _timed(stage_ms: dict[str, float], stage: str) -> Iterator[None]:
    start = perf_counter()
    yield
    stage_ms[stage] = (perf_counter() - start) * 1e3
