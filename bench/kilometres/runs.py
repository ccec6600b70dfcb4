"""One drive through one variant of the estimator, and how far it ends from the truth."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

import numpy as np

from bench.kilometres.drives import Drive
from bench.kilometres.loops import ScriptedLoops
from bench.kilometres.predictions import CachedBackbone
from calm_edge.config import Config, merge
from calm_edge.estimator.localizer import Localizer
from calm_edge.geometry.similarity import align
from calm_edge.types import Float, Int

# Another way to place the sub-maps of a drive: keyframe ids (N,) and T_w_p (N, 4, 4), any unit.
Aligner = Callable[[Drive, CachedBackbone, Config, ScriptedLoops | None], tuple[Int, Float]]


@dataclass(frozen=True, slots=True)
class Variant:
    """A row of a table: changes to the config of the Localizer, or another aligner."""

    name: str
    changes: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    aligner: Aligner | None = None


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a run gave. keyframe_ids: (N,). T_w_p: (N, 4, 4). Errors: m, of all its keyframes.

    ate_sim3_m: after the best similarity, ate_se3_m: after the best rigid motion, the spacing being
    known. ms: wall time a sub-map, finish included. missing: keyframes without a pose.
    """

    keyframe_ids: Int
    T_w_p: Float
    ate_sim3_m: float
    ate_se3_m: float
    path_m: float
    n_submaps: int
    ms: float
    missing: int

    @property
    def percent(self) -> float:
        """The error after the best similarity, of the path."""
        return 100 * self.ate_sim3_m / self.path_m


def run(
    drive: Drive,
    backbone: CachedBackbone,
    variant: Variant,
    config: Config | None = None,
    loops: ScriptedLoops | None = None,
    inspect: Callable[[Localizer], None] | None = None,
) -> Outcome:
    """The drive's windows through the variant, in order, to the end.

    inspect: is given the Localizer when it has finished, where there is one and not an aligner.
    """
    spacing_m = float(np.linalg.norm(drive.scene.T_p_a[:3, 3]))
    known = {"scale": {"spacing_m": spacing_m}, "loops": {"enabled": loops is not None}}
    config = merge(config or Config(), known)
    config = merge(config, {section: dict(keys) for section, keys in variant.changes.items()})
    start = perf_counter()
    if variant.aligner:
        ids, T_w_p = variant.aligner(drive, backbone, config, loops)
    else:
        ids, T_w_p = _localized(drive, backbone, config, loops, inspect)
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
    )


def _localized(
    drive: Drive,
    backbone: CachedBackbone,
    config: Config,
    loops: ScriptedLoops | None,
    inspect: Callable[[Localizer], None] | None,
) -> tuple[Int, Float]:
    """The product's own way: Localizer over the windows, then its final optimum."""
    localizer = Localizer(config, backbone, loops)
    for window in drive.windows:
        localizer.process(window)
    trajectory = localizer.finish()
    if inspect is not None:
        inspect(localizer)
    if trajectory is None:
        return np.zeros(0, np.int64), np.zeros((0, 4, 4))
    return trajectory.keyframe_ids, trajectory.T_w_c


def aligned_error(T_w_p: Float, truth: Float, *, with_scale: bool) -> float:
    """Root mean square distance [m] of positions after alignment; inf without two of them."""
    if len(T_w_p) < 2:
        return float("inf")
    p, p_true = T_w_p[:, :3, 3], truth[:, :3, 3]
    fitted = align(p, p_true, with_scale).points(p)
    return float(np.sqrt(((fitted - p_true) ** 2).sum(1).mean()))
