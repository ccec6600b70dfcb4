"""Rows of the map quality table: point clouds of variants and baselines against the truth."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bench.baselines.chain import BaselineResult
from bench.mapping.build import Built, raw_points
from calm_edge.config import MappingConfig
from calm_edge.evaluation import EvaluationError, cloud, trajectory
from calm_edge.evaluation.results import MIN_POSES
from calm_edge.evaluation.truth import Truth
from calm_edge.geometry import se3
from calm_edge.geometry.similarity import align
from calm_edge.mapping.seams import SeamSummary, summary
from calm_edge.types import Float, Float32, Int, Submap

# Title and settings of each variant, all but the first without one part of section VI. With
# infinite stiffness the thin-plate spline cannot bend: sub-maps are only moved rigidly to fit the
# anchors.
VARIANTS: tuple[tuple[str, dict[str, float | bool]], ...] = (
    ("full", {}),
    ("without suppression", {"suppress": False}),
    ("without distance weight", {"distance_weight": False}),
    ("rigid motion by the anchors", {"stiffness": float("inf")}),
    ("without alignment", {"deform": False}),
)


@dataclass(frozen=True, slots=True)
class Quality:
    """Map quality of one variant or baseline.

    error: distances of map and truth, None if no point lies near the path. seams: distances between
    the positions that two sub-maps give to a common anchor, None for a baseline. failed: reason why
    there is no map, else empty. ghosts: points of ours where nothing is, above the road.
    """

    name: str
    error: cloud.CloudError | None
    seams: SeamSummary | None = None
    failed: str = ""
    ghosts: cloud.Ghosts | None = None


@dataclass(frozen=True, slots=True)
class Cameras:
    """Primary camera centres by which a map is aligned with the truth.

    t_ns: (N,) on the truth's clock. centres_w: (N, 3) m, or any unit if `scale`. scale: also
    estimate the scale.
    """

    t_ns: Int
    centres_w: Float
    scale: bool


def judged(
    points_w: Iterable[Float32 | Float], cameras: Cameras, truth: Truth
) -> cloud.CloudError | None:
    """Compare a point cloud with the truth after alignment by the camera centres.

    points_w: parts (P, 3) of the cloud. None if no point lies near the path. Raises EvaluationError
    as `aligned`.
    """
    points, there = aligned(points_w, cameras, truth)
    return cloud.compare(points, there, truth.T_w_c[:, :3, 3])


def aligned(
    points_w: Iterable[Float32 | Float], cameras: Cameras, truth: Truth
) -> tuple[Float, Float]:
    """Points (N, 3) of a map moved to the truth by its camera centres; those (M, 3) of the truth.

    points_w: parts (P, 3) of the map. Raises EvaluationError if fewer than MIN_POSES cameras have a
    true pose, or if there is no true cloud.
    """
    if truth.cloud is None:
        raise EvaluationError("the truth has no cloud.npy to compare the map with")
    i, j = trajectory.associate(cameras.t_ns, truth.t_ns)
    if len(i) < MIN_POSES:
        raise EvaluationError(f"only {len(i)} cameras have a true pose; {MIN_POSES} are needed")
    path = truth.T_w_c[:, :3, 3]
    motion = align(cameras.centres_w[i], path[j], with_scale=cameras.scale)
    points = motion.points(np.concatenate([np.empty((0, 3)), *points_w]))
    return points, np.asarray(truth.cloud, np.float64)


def on_true_poses(submaps: Sequence[Submap], t_ns: Int, truth: Truth) -> list[Submap]:
    """Place sub-maps by the true pose of their central keyframe, so without drift.

    t_ns: (S,) stamps of these keyframes on the truth's clock. Raises EvaluationError if one has no
    true pose.
    """
    i, j = trajectory.associate(t_ns, truth.t_ns)
    if len(i) < len(submaps):
        raise EvaluationError(f"{len(submaps) - len(i)} sub-maps have no true pose")
    central = np.array([s.T_s_c[s.n_primary // 2] for s in submaps])
    T_w_s = truth.T_w_c[j] @ se3.inverse(central)
    return [replace(s, T_w_s=T) for s, T in zip(submaps, T_w_s, strict=True)]


def ours(
    built: Built,
    config: MappingConfig,
    placed: Sequence[Submap],
    cameras: Cameras,
    truth: Truth,
    folder: Path,
) -> Iterator[Quality]:
    """Yield the map quality of calm-edge for each of VARIANTS.

    placed: the sub-maps with their poses. folder: for temporary files.
    """
    for name, switches in VARIANTS:
        mapper = built.mapper.variant(replace(config, **switches), folder / name)  # type: ignore[arg-type]
        tiles = [tile.points_w for tile in mapper.finish(placed)]
        points, there = aligned(tiles, cameras, truth)
        error = cloud.compare(points, there, truth.T_w_c[:, :3, 3])
        ghosts = cloud.ghosts(points, there, truth.T_w_c)
        yield Quality(name, error, summary(mapper.seams()), ghosts=ghosts)


def baseline(
    built: Built,
    result: BaselineResult,
    config: MappingConfig,
    spacing: float,
    t_ns: Int,
    truth: Truth,
) -> Quality:
    """Map quality of a chaining baseline. t_ns: (N,) of its keyframes on the truth's clock."""
    if result.T_w_c is None:
        return Quality(result.name, None, failed=result.failed)
    pieces = [
        result.transform_points(k, np.asarray(raw_points(built, k, config, spacing), np.float64))
        for k in range(len(built.submaps))
    ]
    cameras = Cameras(t_ns, result.T_w_c[:, :3, 3], True)
    return Quality(result.name, judged(pieces, cameras, truth))
