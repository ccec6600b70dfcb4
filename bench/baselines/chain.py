"""Chain sub-maps into one world by pairwise alignment, as the paper's baselines do (VII)."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from bench.baselines import pose_graph, sim3, sl4, spacing
from bench.baselines.overlap import BaselineError, Correspondences
from calm_edge.types import CalmEdgeError, Float, Int, Submap

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Alignment:
    """A method of aligning a sub-map with its predecessor.

    place: (previous, new, correspondences) -> T_previous_new (4, 4), raw points of the new sub-map
    to raw points of the previous one. poses: (T_w_s, sub-map) -> T_w_c (N, 4, 4) of its N views.
    Both raise BaselineError. group: Lie group of the pose graph that closes loops.
    """

    name: str
    place: Callable[[Submap, Submap, Correspondences], Float]
    poses: Callable[[Float, Submap], Float]
    group: Literal["sim3", "sl4"]


ALIGNMENTS = {
    "sim3": Alignment("Sim(3)", sim3.place, sim3.poses, "sim3"),
    "sl4": Alignment("SL(4)", sl4.place, sl4.poses, "sl4"),
    "spacing": Alignment("spacing", spacing.place, sim3.poses, "sim3"),
}


@dataclass(frozen=True, slots=True)
class LoopOverlap:
    """Correspondences of two sub-maps that a loop closure joins.

    previous, new: indices of the sub-maps, previous < new.
    """

    previous: int
    new: int
    matches: Correspondences


@dataclass(frozen=True, slots=True)
class BaselineResult:
    """Poses of the primary keyframes by an alignment, or the reason of its failure.

    keyframe_ids, t_ns: (N,), each keyframe once, with its pose from the first sub-map that contains
    it. T_w_c: (N, 4, 4), None after a failure. failed: reason, empty on success. transforms: (S, 4,
    4) homogeneous, raw sub-map points -> world, of the sub-maps placed before a failure. World:
    frame and scale of the first sub-map. loops: number of closed loops.
    """

    name: str
    keyframe_ids: Int
    t_ns: Int
    T_w_c: Float | None
    failed: str
    transforms: Float
    loops: int = 0

    def transform_points(self, k: int, points_s: Float) -> Float:
        """Transform raw points (..., 3) of sub-map k to the world.

        Raises IndexError if the sub-map is not placed.
        """
        T = self.transforms[k]
        moved = points_s @ T[:3, :3].T + T[:3, 3]
        with np.errstate(all="ignore"):
            return np.asarray(moved / (points_s @ T[3, :3] + T[3, 3])[..., None])


def chain(
    alignment: Alignment,
    submaps: Sequence[Submap],
    overlaps: Iterable[Correspondences],
    loops: Iterable[LoopOverlap] = (),
) -> BaselineResult:
    """Place each sub-map relative to its predecessor, then close the loops.

    overlaps: correspondences of sub-maps k - 1 and k for k = 1, 2 ...; may be a generator. A
    CalmEdgeError, also one of that generator, is not raised but returned as text in `failed`. Loops
    that cannot be aligned are logged and left out.
    """
    rows = [(k, view) for k, views in enumerate(_first_views(submaps)) for view in views]
    keyframe_ids = np.array([submaps[k].primary_ids[view] for k, view in rows], np.int64)
    t_ns = np.array([submaps[k].t_ns[view] for k, view in rows], np.int64)
    transforms: list[Float] = []
    T_w_c, failed, closed = None, "", 0
    try:
        # results that are not finite raise a BaselineError below
        with np.errstate(all="ignore"):
            ties = _ties(alignment, submaps, overlaps, transforms)
            closures = _closures(alignment, submaps, loops)
            if closures:
                T = pose_graph.optimise(alignment.group, np.stack(transforms), ties, closures)
                transforms, closed = list(T), len(closures)
            T_w_c = _poses(alignment, submaps, transforms, rows)
    except CalmEdgeError as error:
        failed = str(error)
    placed = np.array(transforms).reshape(-1, 4, 4)
    return BaselineResult(alignment.name, keyframe_ids, t_ns, T_w_c, failed, placed, closed)


def _first_views(submaps: Sequence[Submap]) -> list[list[int]]:
    """For each sub-map, indices of the primary views whose keyframes no earlier sub-map has."""
    seen: set[int] = set()
    views = []
    for submap in submaps:
        views.append([view for view, i in enumerate(submap.primary_ids) if i not in seen])
        seen.update(submap.primary_ids)
    return views


def _ties(
    alignment: Alignment,
    submaps: Sequence[Submap],
    overlaps: Iterable[Correspondences],
    transforms: list[Float],
) -> list[pose_graph.Tie]:
    """Align each sub-map with its predecessor; return the relative transforms.

    Appends T_w_s (4, 4) of each sub-map, raw points to the frame of the first sub-map, to
    `transforms`, which after a BaselineError holds the sub-maps placed so far.
    """
    if not submaps:
        raise BaselineError("no sub-map to chain")
    transforms.append(np.diag([submaps[0].scale] * 3 + [1.0]))
    ties: list[pose_graph.Tie] = []
    following = iter(overlaps)
    for k in range(1, len(submaps)):
        matches = next(following, None)
        if matches is None:
            raise BaselineError(f"sub-map {submaps[k].id}: no correspondences with its predecessor")
        T = _placed(alignment, submaps[k - 1], submaps[k], matches)
        T_w_s = transforms[-1] @ T
        if not (np.isfinite(T_w_s).all() and np.linalg.det(T_w_s) > 0):
            raise BaselineError(f"sub-map {submaps[k].id}: the chained transform is not finite")
        transforms.append(T_w_s)
        ties.append(pose_graph.Tie(k - 1, k, T))
    return ties


def _closures(
    alignment: Alignment, submaps: Sequence[Submap], loops: Iterable[LoopOverlap]
) -> list[pose_graph.Tie]:
    closures = []
    for loop in loops:
        try:
            T = _placed(alignment, submaps[loop.previous], submaps[loop.new], loop.matches)
        except BaselineError as error:
            log.warning("%s: a loop is left out: %s", alignment.name, error)
            continue
        closures.append(pose_graph.Tie(loop.previous, loop.new, T))
    return closures


def _placed(alignment: Alignment, previous: Submap, new: Submap, matches: Correspondences) -> Float:
    try:
        return alignment.place(previous, new, matches)
    except (BaselineError, np.linalg.LinAlgError) as error:
        raise BaselineError(
            f"sub-map {new.id} cannot be aligned with {previous.id}: {error}"
        ) from None


def _poses(
    alignment: Alignment,
    submaps: Sequence[Submap],
    transforms: Sequence[Float],
    rows: Sequence[tuple[int, int]],
) -> Float:
    """T_w_c (N, 4, 4) of the views in `rows`, pairs of sub-map index and view index."""
    T_w_c = []
    for submap, T_w_s in zip(submaps, transforms, strict=True):
        try:
            T_w_c.append(alignment.poses(T_w_s, submap))
        except BaselineError as error:
            raise BaselineError(f"sub-map {submap.id}: {error}") from None
    return np.stack([T_w_c[k][view] for k, view in rows])
