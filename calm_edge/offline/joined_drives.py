"""Join drives of one place to one frame: start from agreeing closures, then one pose graph."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calm_edge.config import Config
from calm_edge.estimator.atlas import Atlas
from calm_edge.geometry import se3
from calm_edge.offline.drive import Drive
from calm_edge.offline.shared_places import STRIDE, PlacedDrive, drive_of
from calm_edge.posegraph.optimiser import Immediate
from calm_edge.types import Float, LoopClosure, Submap, Trajectory

# closures that must agree before two drives are joined: a single one may be of a similar place
LEAST_CLOSURES = 2
# agreement of two closures between the same drives: spacings and share of the way between their
# queries, rad
AGREE_SPACINGS, AGREE_SHARE, AGREE_RAD = 4.0, 0.05, np.radians(6.0)
# a drive of another kit has a rig of its own in the graph
_OTHER_KIT = 1000


@dataclass(frozen=True, slots=True)
class Joined:
    """Drives in the frame of the first. drives: by their number; apart: numbers of the others.

    used: closures by pairs of drives.
    """

    drives: dict[int, Drive]
    apart: tuple[int, ...]
    used: dict[tuple[int, int], int]


def join(drives: Sequence[PlacedDrive], found: Sequence[LoopClosure], config: Config) -> Joined:
    """Join the drives that agreeing closures connect with the first one."""
    poses = _poses(drives)
    T_0_n, used = _starts(len(drives), found, poses, config.scale.spacing)
    if len(T_0_n) == 1:
        return Joined({0: drives[0].drive}, tuple(range(1, len(drives))), {})
    atlas = Atlas(config)
    order = sorted(T_0_n)
    for n in order:
        for k, update in enumerate(drives[n].drive.updates):
            apart = T_0_n[n] @ update.submap.T_w_s if n and not k else None
            atlas.add(_numbered(update.submap, n), apart)
    for n in order:
        for update in drives[n].drive.updates:
            if (loop := update.loop) is not None:
                shift = STRIDE * n
                atlas.add_loop(
                    replace(loop, query_id=loop.query_id + shift, match_id=loop.match_id + shift)
                )
    for closure in used:
        atlas.add_loop(closure)
    optimiser = Immediate()
    atlas.request_optimum(optimiser)
    atlas.settle(optimiser)
    placed = {submap.id: submap.T_w_s for submap in atlas.submaps}
    trajectory = atlas.trajectory()
    counts: dict[tuple[int, int], int] = {}
    for closure in used:
        pair = drive_of(closure.match_id), drive_of(closure.query_id)
        counts[pair] = counts.get(pair, 0) + 1
    moved = {n: _moved(drives[n].drive, n, placed, trajectory) for n in order}
    return Joined(moved, tuple(n for n in range(len(drives)) if n not in moved), counts)


def _numbered(submap: Submap, n: int) -> Submap:
    """The sub-map with ids that are unique over all drives."""
    shift = STRIDE * n
    return replace(
        submap,
        id=submap.id + shift,
        primary_ids=tuple(i + shift for i in submap.primary_ids),
        assistant_ids=tuple(i + shift for i in submap.assistant_ids),
        kit_epoch=submap.kit_epoch + _OTHER_KIT * n,
    )


def _moved(drive: Drive, n: int, placed: dict[int, Float], trajectory: Trajectory) -> Drive:
    """The drive with its sub-maps and keyframes where the joint graph places them."""
    own = drive.trajectory
    assert own is not None
    mine = trajectory.keyframe_ids // STRIDE == n
    path = replace(
        own,
        keyframe_ids=trajectory.keyframe_ids[mine] - STRIDE * n,
        t_ns=trajectory.t_ns[mine],
        T_w_c=trajectory.T_w_c[mine],
        epoch=own.epoch + 1,
    )
    updates = [
        replace(
            update,
            submap=replace(update.submap, T_w_s=placed[update.submap.id + STRIDE * n]),
            trajectory=path,
        )
        for update in drive.updates
    ]
    return replace(drive, updates=updates, trajectory=path)


def _poses(drives: Sequence[PlacedDrive]) -> dict[int, Float]:
    """Poses T_w_c (4, 4) of all keyframes, each in the world of its drive."""
    return {
        int(id_) + STRIDE * n: T
        for n, placed in enumerate(drives)
        if placed.drive.trajectory is not None
        for id_, T in zip(
            placed.drive.trajectory.keyframe_ids, placed.drive.trajectory.T_w_c, strict=True
        )
    }


def _starts(
    count: int, found: Sequence[LoopClosure], poses: dict[int, Float], spacing: float
) -> tuple[dict[int, Float], list[LoopClosure]]:
    """World of each drive in that of the first, T_0_n (4, 4), and the closures that agree."""
    known = [c for c in found if c.query_id in poses and c.match_id in poses]
    T_0_n: dict[int, Float] = {0: np.eye(4)}
    used: list[LoopClosure] = []
    while True:
        best: tuple[int, Float, list[LoopClosure]] | None = None
        for n in range(count):
            if n in T_0_n:
                continue
            tied = [c for c in known if _tied(c, n, T_0_n)]
            hypotheses = [_world(c, n, T_0_n, poses) for c in tied]
            for hypothesis, of in zip(hypotheses, tied, strict=True):
                agreeing = [
                    c
                    for c, other in zip(tied, hypotheses, strict=True)
                    if _agree(hypothesis, other, _own(of, n, poses), _own(c, n, poses), spacing)
                ]
                if best is None or len(agreeing) > len(best[2]):
                    best = n, hypothesis, agreeing
        if best is None or len(best[2]) < LEAST_CLOSURES:
            return T_0_n, used
        n, hypothesis, agreeing = best
        T_0_n[n] = hypothesis
        used += agreeing


def _tied(closure: LoopClosure, n: int, T_0_n: dict[int, Float]) -> bool:
    """Whether a closure is between drive n and one that has a place."""
    pair = {drive_of(closure.query_id), drive_of(closure.match_id)}
    return n in pair and len(pair) == 2 and (pair - {n}) <= set(T_0_n)


def _world(closure: LoopClosure, n: int, T_0_n: dict[int, Float], poses: dict[int, Float]) -> Float:
    """T_0_n (4, 4) as one closure has it."""
    query, match = drive_of(closure.query_id), drive_of(closure.match_id)
    T_wm_wq = poses[closure.match_id] @ closure.T_match_query @ se3.inverse(poses[closure.query_id])
    if query == n:
        return np.asarray(T_0_n[match] @ T_wm_wq)
    return np.asarray(T_0_n[query] @ se3.inverse(T_wm_wq))


def _own(closure: LoopClosure, n: int, poses: dict[int, Float]) -> Float:
    """Pose (4, 4) of the closure's keyframe of drive n, in the world of that drive."""
    mine = closure.query_id if drive_of(closure.query_id) == n else closure.match_id
    return poses[mine]


def _agree(T_a: Float, T_b: Float, at_a: Float, at_b: Float, spacing: float) -> bool:
    """Whether two closures place a drive alike, where the second one was measured."""
    off = se3.inverse(T_a @ at_b) @ (T_b @ at_b)
    way = float(np.linalg.norm(at_a[:3, 3] - at_b[:3, 3]))
    near = np.linalg.norm(off[:3, 3]) < AGREE_SPACINGS * spacing + AGREE_SHARE * way
    return bool(near and np.linalg.norm(se3.so3_log(off[:3, :3])) < AGREE_RAD)
