"""True loops of a drive, and a scripted loop finder with misses and false candidates."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from bench.kilometres.drives import Drive
from bench.scripted.batch import false_place
from calm_edge.geometry import se3
from calm_edge.loops.finder import LoopCandidate
from calm_edge.loops.same_place import KnownKit
from calm_edge.types import Bytes, Float, Int, SubmapWindow
from device.frame import Eye

NEAR_M = 4.0
SAME_WAY_RAD = np.radians(45.0)
# Minimum distance of a false candidate from the window, m.
FALSE_M = 40.0


def true_loops(T_w_p: Float, min_gap: int, near_m: float = NEAR_M) -> Int:
    """Pairs (L, 2) of poses (N, 4, 4) that are near in position and heading.

    A pair is (query, earlier match). min_gap: minimum difference of their indices. near_m: maximum
    distance.
    """
    p = T_w_p[:, :3, 3]
    pairs = cKDTree(p).query_pairs(near_m, output_type="ndarray").astype(np.int64)
    match, query = pairs.min(1), pairs.max(1)
    T = se3.inverse(T_w_p[match]) @ T_w_p[query]
    turn = np.linalg.norm(se3.so3_log(T[:, :3, :3]), axis=1)
    kept = (query - match >= min_gap) & (turn < SAME_WAY_RAD)
    found = np.stack([query[kept], match[kept]], 1)
    return found[np.lexsort(found.T[::-1])]


class ScriptedLoops:
    """Scripted `LoopFinder` of a drive; deterministic for a seed.

    detection: probability that the loop of a window that has one is found. false_share: probability
    that any other window gets a false candidate, a keyframe of another place. aliased: loop finder
    and backbone give a false candidate the same wrong relative pose, as for places that look alike,
    so that comparing the two does not reveal it.
    """

    def __init__(
        self,
        drive: Drive,
        min_gap: int = 60,
        detection: float = 0.7,
        false_share: float = 0.0,
        aliased: bool = True,
        seed: int = 0,
    ) -> None:
        self._drive, self._min_gap, self._seed = drive, min_gap, seed
        self._detection, self._false_share, self._aliased = detection, false_share, aliased
        self._spacing = float(np.linalg.norm(drive.scene.T_p_a[:3, 3]))
        self._known: set[int] = set()
        self._loops = true_loops(drive.T_w_p, min_gap)

    def find(
        self, window: SubmapWindow, images: Sequence[Bytes], kit: KnownKit | None
    ) -> LoopCandidate | None:
        """Return at most one candidate among the remembered keyframes."""
        ids = np.array([keyframe.id for keyframe in window.primary])
        rng = np.random.default_rng([self._seed, window.submap_id])
        chance = rng.uniform()
        pairs = self._loops[np.isin(self._loops[:, 0], ids[window.n_overlap :])]
        pairs = pairs[[int(match) in self._known for match in pairs[:, 1]]]
        T_w_p = self._drive.T_w_p
        if len(pairs):
            T = se3.inverse(T_w_p[pairs[:, 0]]) @ T_w_p[pairs[:, 1]]
            nearest = int(np.argmin(np.linalg.norm(T[:, :3, 3], axis=1)))
            query, match = pairs[nearest]
            view = int(np.flatnonzero(ids == query)[0])
            if chance < self._detection:
                return self._candidate(window, view, int(match), T[nearest])
        elif chance < self._false_share:
            apart = np.linalg.norm(T_w_p[:, :3, 3] - T_w_p[ids[-1], :3, 3], axis=1)
            old = np.arange(len(apart)) <= ids[0] - self._min_gap
            places = [k for k in np.flatnonzero(old & (apart > FALSE_M)) if int(k) in self._known]
            if places:
                return self._false(window, int(rng.choice(places)))
        return None

    def remember(self, window: SubmapWindow) -> None:
        """Add the keyframes of a placed window to the possible matches."""
        self._known.update(keyframe.id for keyframe in window.primary)

    def is_true(self, query_id: int, match_id: int) -> bool:
        """Whether the two keyframes of a loop closure are truly at the same place."""
        p = self._drive.T_w_p[[query_id, match_id], :3, 3]
        return bool(np.linalg.norm(p[0] - p[1]) < FALSE_M / 2)

    def _false(self, window: SubmapWindow, match: int) -> LoopCandidate:
        stamp = self._drive.keyframes[match].frame.t_ns
        if (exposures := self._drive.scene.exposures) is not None:
            stamp = int(exposures[Eye.PRIMARY].at(np.array([stamp]))[0])
        view, T = false_place(stamp, len(window.primary))
        if not self._aliased:
            view, T = len(window.primary) - 1, np.eye(4)
        return self._candidate(window, view, match, T)

    def _candidate(
        self, window: SubmapWindow, view: int, match: int, T_query_match: Float
    ) -> LoopCandidate:
        T = np.array(T_query_match)
        T[:3, 3] /= self._spacing
        keyframe = self._drive.keyframes[match]
        return LoopCandidate(view, keyframe, T)
