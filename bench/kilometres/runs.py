"""Run one drive through one variant of the estimator and compute its errors."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from time import perf_counter
from typing import Any

import numpy as np

from bench.kilometres.drives import Drive
from bench.kilometres.lenses import calibration_of
from bench.kilometres.loops import ScriptedLoops
from bench.kilometres.predictions import CachedBackbone
from calm_edge.backbones.base import Backbone
from calm_edge.backbones.undistorted import UndistortedPictures
from calm_edge.config import Config, merge
from calm_edge.estimator.localizer import Localizer
from calm_edge.geometry.similarity import align
from calm_edge.types import Float, Int, Submap

# Method to run instead of the Localizer; returns keyframe ids (N,) and T_w_p (N, 4, 4), any unit.
Aligner = Callable[[Drive, CachedBackbone, Config, ScriptedLoops | None], tuple[Int, Float]]


@dataclass(frozen=True, slots=True)
class Variant:
    """A configuration of our method, or a baseline instead of it.

    changes: {section: {key: value}} to the configuration. aligner: runs instead of the Localizer.
    calibrated: the lenses are known, and the pictures are undistorted.
    """

    name: str
    changes: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    aligner: Aligner | None = None
    calibrated: bool = False


@dataclass(frozen=True, slots=True)
class Outcome:
    """Result of a run.

    keyframe_ids: (N,). T_w_p: (N, 4, 4), any unit. ate_sim3_m, ate_se3_m: ATE [m] after similarity
    and after rigid alignment; the latter is meaningful since the spacing is given. ms: wall time
    per sub-map, `finish` included. missing: number of keyframes without a pose. focal_percent:
    error of the focal lengths at the end, rms of both eyes; NaN for a baseline.
    """

    keyframe_ids: Int
    T_w_p: Float
    ate_sim3_m: float
    ate_se3_m: float
    path_m: float
    n_submaps: int
    ms: float
    missing: int
    focal_percent: float = float("nan")

    @property
    def percent(self) -> float:
        """ATE after Sim(3) alignment, percent of the path."""
        return 100 * self.ate_sim3_m / self.path_m


def run(
    drive: Drive,
    backbone: CachedBackbone,
    variant: Variant,
    config: Config | None = None,
    loops: ScriptedLoops | None = None,
    inspect: Callable[[Localizer], None] | None = None,
) -> Outcome:
    """Run the windows of a drive through a variant and compute the errors.

    inspect: called with the finished Localizer, unless the variant has an aligner.
    """
    spacing_m = float(np.linalg.norm(drive.scene.T_p_a[:3, 3]))
    known = {"scale": {"spacing_m": spacing_m}, "loops": {"enabled": loops is not None}}
    config = merge(config or Config(), known)
    config = merge(config, {section: dict(keys) for section, keys in variant.changes.items()})
    played: Backbone = backbone
    if variant.calibrated:
        config = replace(config, calibration=calibration_of(drive.scene.cameras))
        played = UndistortedPictures(backbone)
    focal_percent = float("nan")
    start = perf_counter()
    if variant.aligner:
        ids, T_w_p = variant.aligner(drive, backbone, config, loops)
    else:
        localizer = _localized(drive, played, config, loops)
        trajectory = localizer.finish()
        ids, T_w_p = np.zeros(0, np.int64), np.zeros((0, 4, 4))
        if inspect is not None:
            inspect(localizer)
        if trajectory is not None:
            ids, T_w_p = trajectory.keyframe_ids, trajectory.T_w_c
            focal_percent = _focal_percent(drive, localizer.submaps[-1])
    ms = (perf_counter() - start) * 1e3 / len(drive.windows)
    truth = drive.T_w_p[ids]
    return Outcome(
        keyframe_ids=ids,
        T_w_p=T_w_p,
        ate_sim3_m=aligned_error(T_w_p, truth, with_scale=True),
        ate_se3_m=aligned_error(T_w_p, truth, with_scale=False),
        path_m=drive.path_m,
        n_submaps=len(drive.windows),
        ms=ms,
        missing=len(drive.keyframes) - len(ids),
        focal_percent=focal_percent,
    )


def _localized(
    drive: Drive, backbone: Backbone, config: Config, loops: ScriptedLoops | None
) -> Localizer:
    """The Localizer after all windows, not finished."""
    localizer = Localizer(config, backbone, loops)
    for window in drive.windows:
        localizer.process(window)
    return localizer


def _focal_percent(drive: Drive, submap: Submap) -> float:
    cameras = submap.cameras[0], submap.cameras[submap.n_primary if submap.assistant_ids else 0]
    pairs = zip(cameras, drive.scene.cameras, strict=True)
    off = np.log([one.fx / true.fx for one, true in pairs])
    return float(100 * np.sqrt((off**2).mean()))


def aligned_error(T_w_p: Float, truth: Float, *, with_scale: bool) -> float:
    """RMS distance [m] to `truth` after rigid or similarity alignment; inf below two poses."""
    if len(T_w_p) < 2:
        return float("inf")
    p, p_true = T_w_p[:, :3, 3], truth[:, :3, 3]
    fitted = align(p, p_true, with_scale).points(p)
    return float(np.sqrt(((fitted - p_true) ** 2).sum(1).mean()))
