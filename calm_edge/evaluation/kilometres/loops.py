"""Places a drive comes back to, and a finder that knows them, misses some, makes up others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from calm_edge.evaluation.kilometres.drives import Drive
from calm_edge.geometry import se3
from calm_edge.types import Float, Int, Keyframe, SubmapWindow

NEAR_M = 4.0
SAME_WAY_RAD = np.radians(45.0)
# A false candidate comes from at least this far away.
FALSE_M = 40.0


def true_loops(T_w_p: Float, min_gap: int, near_m: float = NEAR_M) -> Int:
    """(L, 2) pairs (query, match) of poses (N, 4, 4): near, looking the same way, match earlier."""
    p = T_w_p[:, :3, 3]
    pairs = cKDTree(p).query_pairs(near_m, output_type="ndarray").astype(np.int64)
    match, query = pairs.min(1), pairs.max(1)
    T = se3.inverse(T_w_p[match]) @ T_w_p[query]
    turn = np.linalg.norm(se3.so3_log(T[:, :3, :3]), axis=1)
    kept = (query - match >= min_gap) & (turn < SAME_WAY_RAD)
    found = np.stack([query[kept], match[kept]], 1)
    return found[np.lexsort(found.T[::-1])]


class ScriptedLoops:
    """Candidates of a drive, window by window; the same for equal seeds.

    detection: chance that a window with a true candidate yields it. false_share: chance that any
    other window yields a keyframe of another place.
    """

    def __init__(
        self,
        drive: Drive,
        min_gap: int = 60,
        detection: float = 0.7,
        false_share: float = 0.0,
        seed: int = 0,
    ) -> None:
        self._drive, self._min_gap, self._seed = drive, min_gap, seed
        self._detection, self._false_share = detection, false_share
        self._loops = true_loops(drive.T_w_p, min_gap)

    def find(self, window: SubmapWindow) -> tuple[int, Keyframe] | None:
        """The query's keyframe id and the earlier keyframe that seems to be its place, or None."""
        new = [keyframe.id for keyframe in window.primary[window.n_overlap :]]
        rng = np.random.default_rng([self._seed, window.submap_id])
        chance = rng.uniform()
        pairs = self._loops[np.isin(self._loops[:, 0], new)]
        if len(pairs):
            p = self._drive.T_w_p[:, :3, 3]
            apart = np.linalg.norm(p[pairs[:, 0]] - p[pairs[:, 1]], axis=1)
            query, match = pairs[int(np.argmin(apart))]
            return self._candidate(query, match) if chance < self._detection else None
        if chance < self._false_share and new:
            query = int(rng.choice(new))
            far = np.linalg.norm(
                self._drive.T_w_p[:, :3, 3] - self._drive.T_w_p[query, :3, 3], axis=1
            )
            (places,) = np.nonzero(far[: max(query - self._min_gap, 0)] > FALSE_M)
            if len(places):
                return self._candidate(query, rng.choice(places))
        return None

    def is_true(self, query_id: int, match_id: int) -> bool:
        """Whether a closure joined two views of one place."""
        p = self._drive.T_w_p[[query_id, match_id], :3, 3]
        return bool(np.linalg.norm(p[0] - p[1]) < FALSE_M / 2)

    def _candidate(self, query: int, match: int) -> tuple[int, Keyframe]:
        return int(query), self._drive.keyframes[int(match)]


def with_loop(window: SubmapWindow, loops: ScriptedLoops) -> SubmapWindow:
    """The window with its candidate as loop keyframe, itself where there is none."""
    found = loops.find(window)
    return replace(window, loop_keyframe=found[1]) if found else window
