"""Baselines that align the sub-maps of our method by the depth of pictures they share."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from bench.baselines import overlap
from bench.baselines.chain import ALIGNMENTS, LoopOverlap, chain
from bench.baselines.overlap import Correspondences
from bench.kilometres.drives import Drive
from bench.kilometres.loops import ScriptedLoops
from bench.kilometres.predictions import CachedBackbone
from bench.kilometres.runs import Aligner, Variant
from calm_edge.config import Config
from calm_edge.estimator import scale, window_submap
from calm_edge.types import Float, Hints, Int, Prediction, Submap, SubmapWindow


def rival(name: str, held: HeldViews | None = None) -> Variant:
    """Variant that runs the baseline `name`, `sim3` or `sl4`.

    held: cache to be shared by several baselines, so that depth is computed once.
    """
    return Variant(name, aligner=_aligner(name, held or HeldViews()))


def _aligner(name: str, held: HeldViews) -> Aligner:
    def place(
        drive: Drive, backbone: CachedBackbone, config: Config, loops: ScriptedLoops | None
    ) -> tuple[Int, Float]:
        views = held.of(drive, backbone, config.scale.spacing, loops)
        overlaps = (views.between(k - 1, k) for k in range(1, len(views.submaps)))
        found = chain(ALIGNMENTS[name], views.submaps, overlaps, views.closures())
        if found.T_w_c is None:
            return np.zeros(0, np.int64), np.zeros((0, 4, 4))
        return found.keyframe_ids, found.T_w_c

    return place


class HeldViews:
    """Cache of the sub-maps, before correction, of the drive requested last."""

    def __init__(self) -> None:
        self._of: tuple[Drive, ScriptedLoops | None] | None = None
        self._views: _Views | None = None

    def of(
        self,
        drive: Drive,
        backbone: CachedBackbone,
        spacing: float,
        loops: ScriptedLoops | None,
    ) -> _Views:
        """Return the cached sub-maps if drive and loops are the same objects, else new ones."""
        if (
            self._views is None
            or self._of is None
            or any(a is not b for a, b in zip(self._of, (drive, loops), strict=True))
        ):
            self._of, self._views = (drive, loops), None
            self._views = _Views(drive, backbone, spacing, loops)
        return self._views


class _Views:
    """Sub-maps of a drive before correction, with depth on demand, of common pictures only."""

    def __init__(
        self,
        drive: Drive,
        backbone: CachedBackbone,
        spacing: float,
        loops: ScriptedLoops | None,
    ) -> None:
        self._spacing = spacing
        self._held: dict[int, Prediction] = {}
        self._found: dict[tuple[int, ...], Correspondences] = {}
        self._size = drive.scene.size[0]
        self._backbone = backbone
        self._hints: list[Hints] = []
        self._predictions: list[Prediction] = []
        self._matches: list[tuple[int, int]] = []
        self.submaps: list[Submap] = []
        for window in drive.windows:
            candidate = loops.find(window, [], None) if loops is not None else None
            if candidate is not None:
                window = replace(window, loop_keyframe=candidate.keyframe)
                self._matches.append((len(self.submaps), candidate.keyframe.id))
            if loops is not None:
                loops.remember(window)
            self._add(window)

    def between(self, previous: int, new: int) -> Correspondences:
        """Correspondences in the common keyframes of two sub-maps, given by index."""
        pair = self.submaps[previous], self.submaps[new]
        return self._correspondences(previous, new, *overlap.common_views(*pair))

    def closures(self) -> Iterator[LoopOverlap]:
        """Yield the corresponding points of both sub-maps of each loop closure.

        The later sub-map has a keyframe of the earlier visit appended to its window, as its last
        view. The other one is the first sub-map in which this keyframe is a regular view. The
        points are those at the same pixels of this one picture.
        """
        for query, match_id in self._matches:
            match = next(k for k, s in enumerate(self.submaps) if match_id in s.primary_ids)
            views = overlap.loop_views(self.submaps[match], self.submaps[query], match_id)
            yield LoopOverlap(match, query, self._correspondences(match, query, *views))

    def _add(self, window: SubmapWindow) -> None:
        frames = [keyframe.frame for keyframe in window.keyframes()]
        hints = Hints(
            eyes=np.array([frame.eye for frame in frames], np.int64),
            t_ns=np.array([frame.t_ns for frame in frames], np.int64),
            loop=window.loop_keyframe is not None,
        )
        prediction = replace(self._backbone.infer([], hints), landmarks=None)
        submap = window_submap.raw_submap(window, hints, prediction)
        if not self.submaps:
            # scale the first sub-map by the camera spacing, which makes the chain metric
            n, m = submap.n_primary, len(submap.assistant_ids)
            rig = scale.rig_samples(
                submap.t_ns[:n],
                submap.T_s_c[:n],
                submap.t_ns[n : n + m],
                submap.T_s_c[n : n + m],
            )
            submap = replace(submap, scale=scale.factor(scale.spacing(rig), self._spacing))
        self._hints.append(hints)
        self._predictions.append(prediction)
        self.submaps.append(submap)

    def _correspondences(
        self, previous: int, new: int, views_previous: Int, views_new: Int
    ) -> Correspondences:
        key = previous, new, *views_previous.tolist(), *views_new.tolist()
        if key not in self._found:
            self._found[key] = overlap.correspondences(
                self._with_depth(previous, views_previous),
                views_previous,
                self._with_depth(new, views_new),
                views_new,
                self._size,
            )
        return self._found[key]

    def _with_depth(self, k: int, views: Int) -> Prediction:
        """Prediction of sub-map k with depth in at least the views given by index."""
        held = self._held.get(k)
        if held is not None and held.depth is not None and held.depth[views].any((1, 2)).all():
            return held
        if k + 1 < len(self.submaps):
            # also compute the views that the next sub-map shares, since it needs them soon
            shared = overlap.common_views(self.submaps[k], self.submaps[k + 1])[0]
            views = np.union1d(views, shared)
        some, belief = self._backbone.depth(self._hints[k], views)
        depth = np.zeros((len(self._hints[k].t_ns), *some.shape[1:]), np.float32)
        confidence = np.zeros_like(depth)
        depth[views], confidence[views] = some, belief
        prediction = replace(self._predictions[k], depth=depth, confidence=confidence)
        self._held = {k - 1: self._held[k - 1]} if k - 1 in self._held else {}
        self._held[k] = prediction
        return prediction
