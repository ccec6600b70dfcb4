"""Join drives of one place to one frame: start from agreeing closures, then one pose graph."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from calm_edge.config import Config
from calm_edge.estimator.atlas import Atlas
from calm_edge.geometry import se3
from calm_edge.geometry.similarity import align
from calm_edge.offline.drive import Drive
from calm_edge.offline.shared_places import STRIDE, PlacedDrive, drive_of
from calm_edge.posegraph.optimiser import Immediate
from calm_edge.types import Float, LoopClosure, Submap, Trajectory

# closures that must agree before two drives are joined: a single one may be of a similar place
LEAST_CLOSURES = 2
# agreement of two closures between the same drives: spacings and share of the way between their
# queries, rad
AGREE_SPACINGS, AGREE_SHARE, AGREE_RAD = 4.0, 0.05, np.radians(6.0)
# of the log of lengths: of a drive that does not know its own, and of the ratio of two, at least
UNKNOWN_LOG_SIGMA, LEAST_LOG_SIGMA = 0.1, 0.0005
DISAGREE_SIGMAS = 3.0
# a drive of another kit has a rig of its own in the graph
_OTHER_KIT = 1000


@dataclass(frozen=True, slots=True)
class Joined:
    """Drives in the frame of the first. drives: by their number; apart: numbers of the others.

    used: closures by pairs of drives. scales: factors by which the lengths of the drives were
    multiplied, so that these agree. notes: a line for each pair whose lengths disagree.
    """

    drives: dict[int, Drive]
    apart: tuple[int, ...]
    used: dict[tuple[int, int], int]
    scales: dict[int, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def join(drives: Sequence[PlacedDrive], found: Sequence[LoopClosure], config: Config) -> Joined:
    """Join the drives that agreeing closures connect with the first one."""
    poses = _poses(drives)
    T_0_n, used = _starts(len(drives), found, poses, config.scale.spacing)
    if len(T_0_n) == 1:
        return Joined({0: drives[0].drive}, tuple(range(1, len(drives))), {})
    order = sorted(T_0_n)
    scales, notes = common_scales(drives, used, poses)
    drives = [
        PlacedDrive(each.recording, _scaled(each.drive, scales.get(n, 1.0)))
        for n, each in enumerate(drives)
    ]
    used = [
        replace(c, T_match_query=_stretched(c.T_match_query, scales[drive_of(c.query_id)]))
        for c in used
    ]
    atlas = Atlas(config)
    for n in order:
        for k, update in enumerate(drives[n].drive.updates):
            apart = T_0_n[n] @ update.submap.T_w_s if n and not k else None
            atlas.add(numbered(update.submap, n), apart)
    for n in order:
        for update in drives[n].drive.updates:
            if (loop := update.loop) is not None:
                shift = STRIDE * n
                T = _stretched(loop.T_match_query, scales[n])
                atlas.add_loop(LoopClosure(loop.query_id + shift, loop.match_id + shift, T))
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
    apart_too = tuple(n for n in range(len(drives)) if n not in moved)
    return Joined(moved, apart_too, counts, scales, notes)


def common_scales(
    drives: Sequence[PlacedDrive], used: Sequence[LoopClosure], poses: dict[int, Float]
) -> tuple[dict[int, float], tuple[str, ...]]:
    """Factors of the drives' lengths by which these agree, nearest to 1 by their sigmas.

    Two drives measure the same way between their closures. A line for each pair whose lengths
    differ by more than DISAGREE_SIGMAS.
    """
    pairs: dict[tuple[int, int], list[LoopClosure]] = {}
    for closure in used:
        pair = drive_of(closure.match_id), drive_of(closure.query_id)
        pairs.setdefault(pair, []).append(closure)
    joined = sorted({0, *(n for pair in pairs for n in pair)})
    sigmas = [_length_sigma(drives[n].drive) for n in joined]
    # rows of a least-squares problem for the log factors
    rows, wanted = list(np.diag(1 / np.array(sigmas))), [0.0] * len(joined)
    notes = []
    for (a, b), closures in sorted(pairs.items()):
        T_match = np.array([poses[c.match_id] @ c.T_match_query for c in closures])
        at_b = np.array([poses[c.query_id][:3, 3] for c in closures])
        ratio, sigma = _ratio(T_match[:, :3, 3], at_b)
        i, k = joined.index(a), joined.index(b)
        if not np.isfinite(sigma):
            continue
        row = np.zeros(len(joined))
        row[k], row[i] = 1 / sigma, -1 / sigma
        rows.append(row)
        wanted.append(ratio / sigma)
        allowed = DISAGREE_SIGMAS * float(np.linalg.norm([sigmas[i], sigmas[k], sigma]))
        if abs(ratio) > allowed:
            notes.append(
                f"lengths of drives {a + 1} and {b + 1} differ by {100 * np.expm1(abs(ratio)):.1f} "
                "%; compare scale.spacing_m of both with the cars"
            )
    logs = np.linalg.lstsq(np.array(rows), np.array(wanted), rcond=None)[0]
    factors = np.exp(logs).tolist()
    return dict(zip(joined, factors, strict=True)), tuple(notes)


def _length_sigma(drive: Drive) -> float:
    """Sigma of the log of a drive's lengths."""
    sigma = drive.metre.log_sigma
    return sigma if 0 < sigma < UNKNOWN_LOG_SIGMA else UNKNOWN_LOG_SIGMA


def _ratio(at_a: Float, at_b: Float) -> tuple[float, float]:
    """Log of the factor of b's lengths that gives a's, and its sigma, by common points (N, 3).

    The sigma is inf with less than three points.
    """
    if len(at_a) < 3:
        return 0.0, np.inf
    fit = align(at_b, at_a, with_scale=True)
    off = fit.points(at_b) - at_a
    spread = float(np.linalg.norm(at_a - at_a.mean(0)))
    if spread == 0:
        return 0.0, np.inf
    noise = float(np.sqrt((off**2).sum() / max(1, 3 * len(at_a) - 7)))
    return float(np.log(fit.scale)), max(LEAST_LOG_SIGMA, noise / spread)


def _scaled(drive: Drive, factor: float) -> Drive:
    """The drive with all lengths multiplied."""
    updates = [
        replace(
            update,
            submap=replace(
                update.submap,
                scale=update.submap.scale * factor,
                T_s_c=_stretched(update.submap.T_s_c, factor),
                T_w_s=_stretched(update.submap.T_w_s, factor),
            ),
        )
        for update in drive.updates
    ]
    path = drive.trajectory
    assert path is not None
    rig, T_w_c = _stretched(path.T_p_a, factor), _stretched(path.T_w_c, factor)
    return replace(drive, updates=updates, trajectory=replace(path, T_w_c=T_w_c, T_p_a=rig))


def _stretched(T: Float, factor: float) -> Float:
    stretched = np.array(T)
    stretched[..., :3, 3] *= factor
    return stretched


def numbered(submap: Submap, n: int) -> Submap:
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
