"""Windows in, a trajectory out: sections IV and V of the paper in their order.

Differences from the paper: the spacing itself is the unit (scale.py); windows solved under an
older belief of the kit are solved again (kit_memory.py); a window that cannot be reconstructed
is bridged (atlas.py).
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
    Prediction,
    Submap,
    SubmapWindow,
    Trajectory,
)
from device.frame import UnreadableImage

log = logging.getLogger(__name__)

# Until there are so many times more sub-maps than the last time all were placed anew, only new ones
# follow what was learned: of a long drive most have been told what there is to know.
REPLACE_GROWTH = 1.1
# Sub-maps placed anew with a window, so that its cost does not grow with the drive.
REPLACED_A_WINDOW = 8


class Localizer:
    """Owns the atlas and what is learned of the kit; a deterministic function of its windows.

    loops: finds places again (IV-D), None for what the configuration asks for. optimiser: where
    the joint optimum is computed; beside the live path the result comes with a later window.
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
            knows = descriptor_of(backbone, config.loops.descriptor)
            self._loops = PlaceLoops(config.loops, knows)
        self._optimiser = optimiser or Immediate()
        self._atlas = Atlas(config)
        self._optimised = False
        self._stale = False
        self._placed_anew = 0
        self._replacement: Replacement | None = None
        self._said: set[str] = set()

    @property
    def submaps(self) -> tuple[Submap, ...]:
        """Every sub-map where it now is."""
        return self._atlas.submaps

    @property
    def skipped(self) -> tuple[SkippedWindow, ...]:
        """Windows that could not be reconstructed; the next sub-map's n_overlap is 0."""
        return self._atlas.skipped

    @property
    def intrinsics(self) -> GlobalIntrinsics | None:
        """What the online search holds true (V-A), where it runs."""
        return self._rectifier.intrinsics

    def process(self, window: SubmapWindow) -> LocalizerUpdate | None:
        """One window more; None where it could not be reconstructed (see `skipped`)."""
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
                learned = self._rectifier.learn(raw, prediction.landmarks, images)
            with _timed(stage_ms, "rectify"):
                submap = self._rectifier.rectify(raw)
        except (BackboneError, scale.ScaleError, UnreadableImage) as error:
            self._skip(window, str(error))
            return None
        closed = self._closure(window, submap, prediction, candidate)
        if window.loop_keyframe is not None and closed is None:
            prediction, submap, hints = window_submap.without_loop(prediction, submap, hints)
        with _timed(stage_ms, "place"):
            atlas.add(submap)
            if self._loops is not None:
                self._loops.remember(window)
        with _timed(stage_ms, "resolve"):
            self._memory.add(submap.id, prediction, hints)
            changed = self._kit_prior.contradicted(self._memory.taught())
            notices = self._unsaid((*prediction.notices, *changed))
            self._memory.remembered = self._kit_prior.belief
            self._stale |= learned
            grown = len(atlas) >= REPLACE_GROWTH * self._placed_anew
            if self._stale and grown and self._replacement is None:
                self._begin_replacement(atlas.submaps)
            self._resolve(self._memory.outdated())
            self._replace(REPLACED_A_WINDOW)
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
        )

    def leave_out(self, submap_id: int, t_ns: Int) -> None:
        """A window that will not come. t_ns (N,) of its primary keyframes: there was motion."""
        self._atlas.skip(SkippedWindow(submap_id, "left out", t_ns))

    def finish(self) -> Trajectory | None:
        """Every window under the final belief, then the joint optimum; None without a sub-map."""
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
        self._kit_prior.save(self._memory.taught())
        return self.trajectory()

    def trajectory(self) -> Trajectory:
        """Every primary keyframe that has a pose, once, in order of its id."""
        return self._atlas.trajectory()

    def _hints(self, window: SubmapWindow, images: list[Bytes]) -> Hints:
        frames = [keyframe.frame for keyframe in window.keyframes()]
        sizes = window_submap.sizes(window, images)
        self._kit_prior.open(sizes)
        self._memory.remembered = self._kit_prior.belief
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
        """The window with a picture of the past in its batch, where one shows its place (IV-D).

        A window that comes with one, from a recording, keeps it, unless loops are off.
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
        """T_loop as the backbone measured it, where it did and the look-up does not object."""
        match = window.loop_keyframe
        if match is None or not prediction.loop_found or match.id not in self._atlas:
            return None
        T_s_match = submap.T_s_c[-1]
        apart = np.linalg.norm(submap.T_s_c[: submap.n_primary, :3, 3] - T_s_match[:3, 3], axis=1)
        query = candidate.query_view if candidate is not None else int(apart.argmin())
        T_match_query = se3.inverse(T_s_match) @ submap.T_s_c[query]
        spacing = self._config.scale.spacing
        if candidate is not None and not candidate.agrees(se3.inverse(T_match_query), spacing):
            log.info("sub-map %d: loop to keyframe %d contradicted", submap.id, match.id)
            return None
        return LoopClosure(submap.primary_ids[query], match.id, T_match_query)

    def _unsaid(self, lines: Sequence[str]) -> tuple[str, ...]:
        """Those that this drive has not brought yet."""
        new = tuple(line for line in dict.fromkeys(lines) if line not in self._said)
        self._said.update(new)
        return new

    def _skip(self, window: SubmapWindow, reason: str) -> None:
        log.warning("sub-map %d skipped: %s", window.submap_id, reason)
        t_ns = np.array([keyframe.frame.t_ns for keyframe in window.primary], np.int64)
        self._atlas.skip(SkippedWindow(window.submap_id, reason, t_ns))

    def _resolve(self, submap_ids: list[int]) -> None:
        """Solves windows again as the kit is now known; where that worked, all are placed anew."""
        solved = self._memory.resolve(submap_ids)
        if solved:
            raw = [window_submap.solved_again(s, solved.get(s.id)) for s in self._sources()]
            self._begin_replacement(raw)

    def _sources(self) -> tuple[Submap, ...]:
        """Every sub-map with the newest raw poses there are."""
        return self._replacement.sources if self._replacement else self._atlas.submaps

    def _begin_replacement(self, submaps: Sequence[Submap]) -> None:
        """From now on the sub-maps are rectified from their raw poses and placed anew."""
        self._stale, self._placed_anew = False, len(submaps)
        rectify = partial(self._rectifier.rectify, held=self._rectifier.held)
        self._replacement = Replacement(self._atlas, submaps, rectify)

    def _replace(self, most: int | None = None) -> None:
        """At most so many sub-maps more are placed anew, None for all that are to be."""
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
