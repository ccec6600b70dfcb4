"""Windows in, a trajectory out: sections IV and V of the paper in their order.

Differences from the paper: the spacing itself is the unit (scale.py); windows solved under an
older belief of the kit are solved again (kit_memory.py); a window that cannot be reconstructed
is bridged (atlas.py). Scale comes after the correction of poses: with a wrong focal the lateral
spacing is wrong while forward motion is kept, so the other order would put the focal's error
into the scale.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from time import perf_counter

import numpy as np

from calm_edge import scale
from calm_edge.atlas import Atlas, SkippedWindow
from calm_edge.backbones.base import Backbone, BackboneError
from calm_edge.backbones.kit_memory import KitMemory
from calm_edge.config import Config
from calm_edge.geometry import se3
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


class Localizer:
    """Owns the atlas and what is learned of the kit; a deterministic function of its windows."""

    def __init__(self, config: Config, backbone: Backbone) -> None:
        self._config = config
        self._backbone = backbone
        self._memory = KitMemory(backbone, config.backbone.resolve_windows)
        self._atlas = Atlas(config)
        self._first_scale: float | None = None
        self._optimised = False

    @property
    def submaps(self) -> tuple[Submap, ...]:
        """Every sub-map where it now is."""
        return self._atlas.submaps

    @property
    def skipped(self) -> tuple[SkippedWindow, ...]:
        """Windows that could not be reconstructed; the next sub-map's n_overlap is 0."""
        return self._atlas.skipped

    def process(self, window: SubmapWindow) -> LocalizerUpdate | None:
        """One window more; None where it could not be reconstructed (see `skipped`)."""
        atlas, stage_ms = self._atlas, dict[str, float]()
        newest, epoch = atlas.newest_keyframe, atlas.epoch
        before = atlas.pose(newest) if newest is not None else np.eye(4)
        try:
            with _timed(stage_ms, "decode"):
                images = [keyframe.frame.bgr() for keyframe in window.keyframes()]
            hints = self._hints(window, images)
            with _timed(stage_ms, "infer"):
                prediction = self._backbone.infer(images, hints)
            with _timed(stage_ms, "scale"):
                submap = self._scaled(_raw(window, hints, prediction))
        except (BackboneError, scale.ScaleError, UnreadableImage) as error:
            self._skip(window, str(error))
            return None
        with _timed(stage_ms, "place"):
            atlas.add(submap)
        with _timed(stage_ms, "resolve"):
            self._memory.add(submap.id, prediction, hints)
            self._resolve(self._memory.outdated())
        placed, moved = atlas.submaps[-1], atlas.epoch != epoch
        after = atlas.pose(newest) if newest is not None else before
        return LocalizerUpdate(
            submap=placed,
            prediction=prediction,
            trajectory=atlas.trajectory() if moved else atlas.trajectory_of(placed),
            T_odom_correction=after @ se3.inverse(before) if moved else np.eye(4),
            stage_ms=stage_ms,
            kit=self._memory.belief(),
        )

    def close_loop(self, loop: LoopClosure) -> Trajectory:
        """Adds E_loop and optimises; KeyError where a keyframe has no pose."""
        self._atlas.add_loop(loop)
        self._optimise()
        return self.trajectory()

    def finish(self) -> Trajectory | None:
        """Every window under the final belief, then the joint optimum; None without a sub-map."""
        if not len(self._atlas):
            return None
        self._optimised = False
        self._resolve(self._memory.retained())
        self._optimise()
        return self.trajectory()

    def trajectory(self) -> Trajectory:
        """Every primary keyframe that has a pose, once, in order of its id."""
        return self._atlas.trajectory()

    def _hints(self, window: SubmapWindow, images: list[Bytes]) -> Hints:
        frames = [keyframe.frame for keyframe in window.keyframes()]
        return Hints(
            eyes=np.array([frame.eye for frame in frames], np.int64),
            t_ns=np.array([frame.t_ns for frame in frames], np.int64),
            hfov_deg=self._config.backbone.hfov_of_eye,
            kit=self._memory.belief(),
            sizes=_sizes(window, images),
        )

    def _scaled(self, submap: Submap) -> Submap:
        """IV-B; with `scale.rectify` off the first sub-map's factor is everyone's."""
        scaled = scale.rectify(submap, self._config.scale.spacing_m)
        if self._config.scale.rectify or self._first_scale is None:
            self._first_scale = scaled.scale
            return scaled
        T_s_c = scale.rectified(submap.T_s_c, self._first_scale)
        return replace(submap, scale=self._first_scale, T_s_c=T_s_c)

    def _skip(self, window: SubmapWindow, reason: str) -> None:
        log.warning("sub-map %d skipped: %s", window.submap_id, reason)
        t_ns = np.array([keyframe.frame.t_ns for keyframe in window.primary], np.int64)
        self._atlas.skip(SkippedWindow(window.submap_id, reason, t_ns))

    def _resolve(self, submap_ids: list[int]) -> None:
        """Solves windows again as the kit is now known and, where that worked, places all anew."""
        solved = self._memory.resolve(submap_ids)
        if not solved:
            return
        self._atlas.replace_all([self._resolved(s, solved.get(s.id)) for s in self._atlas.submaps])
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
            T_s_c=prediction.T_s_c,
            K=prediction.K,
            focal_log_sigma=_focal_log_sigma(submap.n_primary, prediction),
            assistant_late_ns=round(prediction.assistant_late_s * 1e9),
        )
        try:
            return self._scaled(raw)
        except scale.ScaleError as error:
            log.warning("sub-map %d keeps its earlier solution: %s", submap.id, error)
            return submap

    def _optimise(self) -> None:
        self._atlas.optimise()
        self._optimised = True


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
        assistant_late_ns=round(prediction.assistant_late_s * 1e9),
    )


def _sizes(window: SubmapWindow, images: list[Bytes]) -> Int | None:
    """(2, 2) width and height [px] of each eye's pictures, None without an assistant."""
    if not window.assistant:
        return None
    shapes = [images[0].shape, images[len(window.primary)].shape]
    return np.array([[shape[1], shape[0]] for shape in shapes], np.int64)


def _focal_log_sigma(n_primary: int, prediction: Prediction) -> Float:
    """(2,) an eye; inf where the model does not know its focal's error."""
    sigma = prediction.focal_log_sigma
    if sigma is None or len(sigma) <= n_primary:
        return np.full(len(Eye), np.inf)
    return np.asarray(sigma[[0, n_primary]])


@contextmanager
def _timed(stage_ms: dict[str, float], stage: str) -> Iterator[None]:
    start = perf_counter()
    yield
    stage_ms[stage] = (perf_counter() - start) * 1e3
