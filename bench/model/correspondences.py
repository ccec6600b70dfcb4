"""Measure the share of correct correspondences of several matchers at the same query points."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.model import described
from bench.model.degrade import DEGRADATIONS
from bench.model.protocols import Matcher, Matches
from bench.model.scenes import Pair, Scene, pairs, prepared
from bench.model.truth import transfer
from bench.paired import PairedRatio, compare
from calm_edge.types import Bytes, CalmEdgeError, Float

# Query points of each kind. Both kinds are used so as to favour neither SIFT nor corner tracking.
QUERIES = 200
KINDS = ("SIFT", "corner")
ALL = "all"
THRESHOLDS_PX = (1.0, 3.0)
# Kinds of pairs (`Pair.case`) also measured on degraded pictures (night, motion blur, JPEG).
# "3 on": from a primary keyframe to the third keyframe after it. "eyes": from the primary's picture
# to the assistant's of the same frame number.
DEGRADED_CASES = ("3 on", "eyes")
# A pair with fewer visible query points is skipped.
MIN_QUERIES = 20


@dataclass(frozen=True, slots=True)
class Score:
    """Result of one matcher on one pair, over the visible query points of one kind, or of ALL.

    queries: number of query points. within: numbers found within each of THRESHOLDS_PX of the
    truth. found: number that the matcher reports as found. error_px: median error of those within
    the last threshold. claimed: their root mean square of error over reported sigma, per axis; NaN
    if the matcher reports no sigma.
    """

    matcher: str
    scene: str
    case: str
    degraded: str
    place: int
    kind: str
    queries: int
    within: tuple[int, ...]
    found: int
    error_px: float
    claimed: float

    def share(self, threshold: int = 0) -> float:
        """Share of query points found within THRESHOLDS_PX[threshold].

        Half a query is counted as correct and half as wrong in addition, to keep ratios finite.
        """
        return (self.within[threshold] + 0.5) / (self.queries + 1)


def query_points(pair: Pair) -> tuple[Float, NDArray[np.int64]]:
    """Choose query points (N, 2) px in picture a that are visible in b.

    Up to QUERIES of each kind. Also returns the kinds (N,), as indices of KINDS.
    """
    chosen = []
    for points in candidates(pair.a.image, pair.a.seed):
        _, seen = transfer(pair.a.truth, pair.b.truth, points)
        chosen.append(points[seen][:QUERIES])
    kind = np.repeat(np.arange(len(chosen)), [len(points) for points in chosen])
    return np.concatenate(chosen), kind


def candidates(image: Bytes, seed: int) -> list[Float]:
    """Detect the points (N, 2) px of each of KINDS in a picture (H, W, 3).

    They are in random order, by the seed.
    """
    gray, rng = described.gray_of(image), np.random.default_rng(seed)
    own = np.array([p.pt for p in described.keypoints(gray, 4 * QUERIES)]).reshape(-1, 2)
    kinds = np.unique(own, axis=0), described.corners(gray, 2 * QUERIES)
    return [np.asarray(p, np.float64)[rng.permutation(len(p))] for p in kinds]


def judge(matches: Matches, true_uv: Float) -> tuple[tuple[int, ...], int, float, float]:
    """Compute `within`, `found`, `error_px` and `claimed` of Score. true_uv: (N, 2) px."""
    off = np.where(matches.found, np.linalg.norm(matches.uv_b - true_uv, axis=1), np.inf)
    right = off <= THRESHOLDS_PX[-1]
    error = float(np.median(off[right])) if right.any() else float("nan")
    sigma = matches.sigma_px[right]
    known = np.isfinite(sigma) & (sigma > 0)
    ratio = off[right][known] / sigma[known]
    claimed = float(np.sqrt((ratio**2).mean() / 2)) if known.any() else float("nan")
    within = tuple(int((off <= limit).sum()) for limit in THRESHOLDS_PX)
    return within, int(matches.found.sum()), error, claimed


def measure_pair(pair: Pair, matchers: Mapping[str, Matcher]) -> list[Score]:
    """Score all matchers on a pair, and in DEGRADED_CASES also on its degraded pictures.

    The query points are always those detected in the clean picture.
    """
    uv, kind = query_points(pair)
    if len(uv) < MIN_QUERIES:
        return []
    true_uv, _ = transfer(pair.a.truth, pair.b.truth, uv)
    made = {"": (pair.a.image, pair.b.image)}
    if pair.case in DEGRADED_CASES:
        for name, worse in DEGRADATIONS.items():
            sides = (pair.a, pair.b)
            first, second = (worse(side.image, side.seed) for side in sides)
            made[name] = (first, second)
    scores = []
    for degraded, (a, b) in made.items():
        for name, matcher in matchers.items():
            found = matcher.match(a, b, uv)
            parts = {ALL: kind >= 0} | {label: kind == k for k, label in enumerate(KINDS)}
            for label, own in parts.items():
                part = Matches(found.uv_b[own], found.found[own], found.sigma_px[own])
                figures = judge(part, true_uv[own])
                key = (name, pair.scene, pair.case, degraded, pair.place, label)
                scores.append(Score(*key, int(own.sum()), *figures))
    return scores


def measure(
    scenes: Iterable[Scene], matchers: Mapping[str, Matcher], out: Path
) -> tuple[list[Score], list[str]]:
    """Score all matchers on all drives.

    Also returns notes on the drives that were skipped or stopped by an error.
    """
    scores: list[Score] = []
    skipped: list[str] = []
    by_name = {scene.name: scene for scene in scenes}
    drives = {name: scene.prepare for name, scene in by_name.items()}
    for name, folder in prepared(drives, None, out, skipped):
        try:
            for pair in pairs(by_name[name], folder):
                scores += measure_pair(pair, matchers)
        except CalmEdgeError as error:
            skipped.append(f"{name} stopped: {error}")
    return scores, skipped


def rows(scores: Sequence[Score]) -> list[tuple[Any, ...]]:
    """Table rows, one for each case, degradation and matcher.

    Shares [percent] are over the query points of all pairs.
    """
    out: list[tuple[Any, ...]] = []
    keys = dict.fromkeys((s.case, s.degraded, s.matcher) for s in scores)
    order = list(dict.fromkeys((case, degraded) for case, degraded, _ in keys))
    for case, degraded, name in sorted(keys, key=lambda k: order.index(k[:2])):
        own = [s for s in scores if (s.case, s.degraded, s.matcher) == (case, degraded, name)]
        of = {kind: [s for s in own if s.kind == kind] for kind in (ALL, *KINDS)}
        both = of[ALL]
        found, correct = sum(s.found for s in both), sum(s.within[-1] for s in both)
        out.append((
            case, degraded or "clean", name,
            *(_percent(of[ALL], k) for k in range(len(THRESHOLDS_PX))),
            *(_percent(of[kind], 0) for kind in KINDS),
            round(100 * correct / found, 1) if found else None,
            _middle([s.error_px for s in both]), _middle([s.claimed for s in both]),
            sum(s.queries for s in both),
        ))  # fmt: skip
    return out


COLUMNS = (
    "case", "pictures", "matcher", "1 px %", "3 px %", "1 px % at SIFT's", "1 px % at corners",
    "of found 3 px %", "error px", "error / sigma", "queries",
)  # fmt: skip


def against(
    scores: Sequence[Score], ours: str, other: str, case: str, threshold: int
) -> PairedRatio | None:
    """Ratio of the share of correct matches of `other` to that of `ours`, on one case of pairs.

    Below 1 `ours` is better. On pictures that are not degraded. threshold: index into
    THRESHOLDS_PX. None without pairs that both were run on.
    """
    mine, theirs = (_shares(scores, name, case, "", threshold) for name in (ours, other))
    return compare(theirs, mine) if mine.keys() & theirs.keys() else None


def retained_against(
    scores: Sequence[Score], ours: str, other: str, degraded: str
) -> PairedRatio | None:
    """Ratio of `other` to `ours` in the correct matches on degraded over those on clean pictures.

    A match is correct within 1 px. degraded: kind of degradation. Below 1 `ours` loses less. None
    without pairs that both were run on.
    """
    kept = []
    for name in (other, ours):
        both: dict[tuple[str, int], float | None] = {}
        for number, case in enumerate(DEGRADED_CASES):
            clean = _shares(scores, name, case, "", 0)
            for (scene, place), share in _shares(scores, name, case, degraded, 0).items():
                before = clean[scene, place]
                if share is not None and before is not None:
                    both[scene, place * len(DEGRADED_CASES) + number] = share / before
        kept.append(both)
    theirs, mine = kept
    return compare(theirs, mine) if theirs.keys() & mine.keys() else None


def _shares(
    scores: Sequence[Score], name: str, case: str, degraded: str, threshold: int
) -> dict[tuple[str, int], float | None]:
    key = (name, case, degraded, ALL)
    return {
        (s.scene, s.place): s.share(threshold)
        for s in scores
        if (s.matcher, s.case, s.degraded, s.kind) == key
    }


def _percent(scores: Sequence[Score], threshold: int) -> float | None:
    total = sum(s.queries for s in scores)
    return round(100 * sum(s.within[threshold] for s in scores) / total, 1) if total else None


def _middle(values: Iterable[float]) -> float | None:
    finite = [v for v in values if np.isfinite(v)]
    return float(np.median(finite)) if finite else None
