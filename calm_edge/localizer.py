"""Windows in, a trajectory out: sections IV-A to IV-C of the paper in their order.

Differences from the paper: the spacing itself is the unit (scale.py); windows solved under an
older belief of the kit are solved again (kit_memory.py); a window that cannot be reconstructed
is bridged (`_bridge`). As T_w_f of IV-B implies, a keyframe belongs to the first sub-map that
placed it, and later sub-maps place themselves by it.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from calm_edge import scale
from calm_edge.backbones.base import Backbone, BackboneError
from calm_edge.backbones.kit_memory import KitMemory
from calm_edge.config import Config
from calm_edge.geometry import se3
from calm_edge.posegraph.joint_graph import JointGraph
from calm_edge.types import (
    Bytes,
    Float,
    Hints,
    Int,
    LocalizerUpdate,
    LoopClosure,
    Prediction,
    Submap,
    SubmapWindow,
    Trajectory,
)
from device.frame import Eye, UnreadableImage

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class SkippedWindow:
    """A window without a sub-map. t_ns: (N,) of its primary keyframes."""

    submap_id: int
    reason: str
    t_ns: Int


class Localizer:
    """Owns sub-maps, pose graph and kit memory; a deterministic function of its windows."""

    def __init__(self, config: Config, backbone: Backbone) -> None:
        self._config = config
        self._backbone = backbone
        self._memory = KitMemory(backbone, config.backbone.resolve_windows)
        self._submaps: list[Submap] = []
        self._skipped: list[SkippedWindow] = []
        self._loops: list[LoopClosure] = []
        self._stamps: dict[int, int] = {}
        self._epoch = 0
        self._optimised = False
        self._graph = self._empty_graph()

    @property
    def submaps(self) -> tuple[Submap, ...]:
        """Every sub-map where it now is."""
        return tuple(self._submaps)

    @property
    def skipped(self) -> tuple[SkippedWindow, ...]:
        """Windows that could not be reconstructed; the next sub-map's n_overlap is 0."""
        return tuple(self._skipped)

    def process(self, window: SubmapWindow) -> LocalizerUpdate | None:
        """One window more; None where it could not be reconstructed (see `skipped`)."""
        before, stage_ms = self.trajectory(), dict[str, float]()
        try:
            with _timed(stage_ms, "decode"):
                images = [keyframe.frame.bgr() for keyframe in window.keyframes()]
            hints = self._hints(window, images)
            with _timed(stage_ms, "infer"):
                prediction = self._backbone.infer(images, hints)
            with _timed(stage_ms, "scale"):
                submap = scale.rectify(_raw(window, hints, prediction), self._spacing_m)
        except (BackboneError, scale.ScaleError, UnreadableImage) as error:
            self._skip(window, str(error))
            return None
        with _timed(stage_ms, "place"):
            self._stamps.update((k.id, k.frame.t_ns) for k in window.primary)
            self._append(submap)
        with _timed(stage_ms, "resolve"):
            self._memory.add(submap.id, prediction, hints)
            self._resolve(self._memory.outdated())
        after = self.trajectory()
        return LocalizerUpdate(
            submap=self._submaps[-1],
            prediction=prediction,
            trajectory=after,
            T_odom_correction=_correction(before, after),
            stage_ms=stage_ms,
            kit=self._memory.belief(),
        )

    def close_loop(self, loop: LoopClosure) -> Trajectory:
        """Adds E_loop and optimises; KeyError where a keyframe has no pose."""
        self._graph.add_loop(loop)
        self._loops.append(loop)
        self._optimise()
        return self.trajectory()

    def finish(self) -> Trajectory | None:
        """Every window under the final belief, then the joint optimum; None without a sub-map."""
        if not self._submaps:
            return None
        self._optimised = False
        self._resolve(self._memory.retained())
        self._optimise()
        return self.trajectory()

    def trajectory(self) -> Trajectory:
        """Every primary keyframe that has a pose, once, in order of its id."""
        ids = self._graph.keyframe_ids
        order = np.argsort(ids)
        return Trajectory(
            keyframe_ids=ids[order],
            t_ns=np.array([self._stamps[int(i)] for i in ids[order]], np.int64),
            T_w_c=self._graph.poses()[order],
            T_p_a=self._graph.T_p_a,
            epoch=self._epoch,
        )

    @property
    def _spacing_m(self) -> float:
        return self._config.scale.spacing_m

    def _empty_graph(self) -> JointGraph:
        return JointGraph(self._config.posegraph, self._spacing_m or 1.0)

    def _hints(self, window: SubmapWindow, images: list[Bytes]) -> Hints:
        frames = [keyframe.frame for keyframe in window.keyframes()]
        return Hints(
            eyes=np.array([frame.eye for frame in frames], np.int64),
            t_ns=np.array([frame.t_ns for frame in frames], np.int64),
            hfov_deg=self._config.backbone.hfov_of_eye,
            kit=self._memory.belief(),
            sizes=_sizes(window, images),
        )

    def _append(self, submap: Submap) -> None:
        """Places a rectified sub-map and adds its measurements to the graph."""
        graph, ids = self._graph, submap.primary_ids
        primary, assistant = np.split(_rig_views(submap), [submap.n_primary])
        t_p, t_a = submap.t_ns[primary], submap.t_ns[assistant]
        T_s_p, T_s_a = submap.T_s_c[primary], submap.T_s_c[assistant]
        common = [view for view in range(submap.n_overlap) if ids[view] in graph]
        if common:
            T_w_f = np.stack([graph.pose(ids[view]) for view in common])
            T_w_s = scale.placement(T_w_f, T_s_p[common], self._config.scale.average_placement)
        else:
            T_w_s = scale.placement(self._bridge(submap)[None], T_s_p[:1])
        if not len(graph):
            graph.set_rig_prior(se3.mean(scale.rig_samples(t_p, T_s_p, t_a, T_s_a)))
        graph.add_submap(ids, T_w_s, T_s_p, *scale.resampled(t_a, T_s_a, t_p))
        if self._submaps and not common:
            graph.add_bridge(self._submaps[-1].primary_ids[-1], ids[0])
        self._submaps.append(replace(submap, n_overlap=len(common), T_w_s=T_w_s))

    def _bridge(self, submap: Submap) -> Float:
        """T_w_f (4, 4) of a sub-map's first frame when none of its frames has a pose.

        The velocity between the last two keyframes goes on for as long as the skipped keyframes
        show motion: where nothing moves there are none for longer than max_keyframe_gap_s.
        """
        if not self._submaps:
            return np.eye(4)
        ids = self._submaps[-1].primary_ids[-2:]
        start, end = self._stamps[ids[-1]], int(submap.t_ns[0])
        between = [t for skipped in self._skipped for t in skipped.t_ns if start < t < end]
        gaps = np.diff(np.unique([start, *between, end])) * 1e-9
        # a keyframe forced by the clock comes at the limit, or a frame or two later
        moving_s = gaps[gaps < 2 * self._config.frontend.max_keyframe_gap_s].sum()
        T_last = self._graph.pose(ids[-1])
        step_s = (start - self._stamps[ids[0]]) * 1e-9
        if step_s == 0:
            return T_last
        step = se3.inverse(self._graph.pose(ids[0])) @ T_last
        return np.asarray(T_last @ se3.exp(se3.log(step) * moving_s / step_s))

    def _skip(self, window: SubmapWindow, reason: str) -> None:
        log.warning("sub-map %d skipped: %s", window.submap_id, reason)
        t_ns = np.array([keyframe.frame.t_ns for keyframe in window.primary], np.int64)
        self._skipped.append(SkippedWindow(window.submap_id, reason, t_ns))

    def _resolve(self, submap_ids: list[int]) -> None:
        """Solves windows again as the kit is now known and, where that worked, rebuilds all."""
        solved = self._memory.resolve(submap_ids)
        if not solved:
            return
        submaps, self._submaps = self._submaps, []
        self._graph = self._empty_graph()
        for submap in submaps:
            self._append(self._resolved(submap, solved.get(submap.id)))
        for loop in self._loops:
            self._graph.add_loop(loop)
        self._epoch += 1
        if self._optimised:
            self._optimise()

    def _resolved(self, submap: Submap, prediction: Prediction | None) -> Submap:
        """The sub-map with a later prediction's poses, itself where that has no scale."""
        if prediction is None:
            return submap
        raw = replace(
            submap,
            T_s_c_raw=prediction.T_s_c,
            K_raw=prediction.K,
            K=prediction.K,
            focal_log_sigma=_focal_log_sigma(submap.n_primary, prediction),
        )
        try:
            return scale.rectify(raw, self._spacing_m)
        except scale.ScaleError as error:
            log.warning("sub-map %d keeps its earlier solution: %s", submap.id, error)
            return submap

    def _optimise(self) -> None:
        """The joint optimum (IV-C); each sub-map follows the mean motion of its keyframes."""
        self._graph.optimise()
        self._optimised = True
        self._epoch += 1
        for k, submap in enumerate(self._submaps):
            T_w_p = np.stack([self._graph.pose(i) for i in submap.primary_ids])
            T_w_s = scale.placement(T_w_p, submap.T_s_c[: submap.n_primary], average=True)
            self._submaps[k] = replace(submap, T_w_s=T_w_s)


def _raw(window: SubmapWindow, hints: Hints, prediction: Prediction) -> Submap:
    """The window as a sub-map, neither rectified nor placed."""
    return Submap(
        id=window.submap_id,
        primary_ids=tuple(keyframe.id for keyframe in window.primary),
        assistant_ids=tuple(keyframe.id for keyframe in window.assistant),
        n_overlap=window.n_overlap,
        t_ns=hints.t_ns,
        T_s_c_raw=prediction.T_s_c,
        K_raw=prediction.K,
        T_s_c=prediction.T_s_c,
        K=prediction.K,
        scale=1.0,
        T_w_s=np.eye(4),
        focal_log_sigma=_focal_log_sigma(len(window.primary), prediction),
    )


def _sizes(window: SubmapWindow, images: list[Bytes]) -> Int | None:
    """(2, 2) width and height [px] of each eye's pictures, None without an assistant."""
    if not window.assistant:
        return None
    shapes = [images[0].shape, images[len(window.primary)].shape]
    return np.array([[shape[1], shape[0]] for shape in shapes], np.int64)


def _rig_views(submap: Submap) -> Int:
    """Batch indices of the primary, then the assistant keyframes; no loop keyframe."""
    return np.arange(submap.n_primary + len(submap.assistant_ids))


def _focal_log_sigma(n_primary: int, prediction: Prediction) -> Float:
    """(2,) an eye; inf where the model does not know its focal's error."""
    sigma = prediction.focal_log_sigma
    if sigma is None or len(sigma) <= n_primary:
        return np.full(len(Eye), np.inf)
    return np.asarray(sigma[[0, n_primary]])


def _correction(before: Trajectory, after: Trajectory) -> Float:
    """New world<-old world (4, 4) of the newest keyframe both share."""
    shared = np.intersect1d(before.keyframe_ids, after.keyframe_ids)
    if not len(shared):
        return np.eye(4)
    old = before.T_w_c[np.searchsorted(before.keyframe_ids, shared[-1])]
    new = after.T_w_c[np.searchsorted(after.keyframe_ids, shared[-1])]
    return np.eye(4) if np.array_equal(old, new) else new @ se3.inverse(old)


@contextmanager
def _timed(stage_ms: dict[str, float], stage: str) -> Iterator[None]:
    start = perf_counter()
    yield
    stage_ms[stage] = (perf_counter() - start) * 1e3
