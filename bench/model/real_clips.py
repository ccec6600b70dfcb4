"""Correspondences on real clips, measured by their distance from the true epipolar lines.

Real clips have no true depth. So an error along the epipolar line is not noticed, and points that
are invisible in the other picture cannot be excluded.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bench.drives import DATA, pictures, read_picture, there
from bench.model.correspondences import MIN_QUERIES, QUERIES, candidates
from bench.model.match_table import ratio_check
from bench.model.matchers import BASELINES
from bench.model.ours import OURS, contestant
from bench.model.protocols import Matcher, Matches
from bench.model.scenes import GAPS, keyframes, places, prepared
from bench.paired import compare
from bench.tables import OUT, Check, Table, publish
from calm_edge.evaluation import EvaluationError
from calm_edge.evaluation.truth import read_truth
from calm_edge.geometry import epipolar, se3
from calm_edge.recording.sequence_folder import SequenceFolder
from calm_edge.types import Bytes, Float

PLACES = 5
THRESHOLDS_PX = (1.0, 3.0)


@dataclass(frozen=True, slots=True)
class Clip:
    """A rectified stereo clip. posed: whether its poses are accurate to a pixel."""

    name: str
    spacing_m: float
    posed: bool


# The poses of karlsruhe_town are not accurate to a pixel: they are those of its INS, which is
# mounted at six degrees of pitch.
CLIPS = (
    Clip("kitti06_straight", 0.5372, posed=True),
    Clip("karlsruhe_town", 0.5712, posed=False),
    Clip("kitti_raw_0001", 0.537, posed=False),
)


@dataclass(frozen=True, slots=True)
class RealPair:
    """Pictures a and b (H, W, 3) BGR and their true fundamental matrix F, `x_b^T F x_a = 0`."""

    case: str
    clip: str
    place: int
    a: Bytes
    b: Bytes
    F: Float


@dataclass(frozen=True, slots=True)
class LineScore:
    """Result of one matcher on one pair.

    queries: number of query points. found: number reported as found. within: numbers found within
    each of THRESHOLDS_PX of the epipolar line. error_px: median distance of those within the last
    threshold.
    """

    matcher: str
    clip: str
    case: str
    place: int
    queries: int
    found: int
    within: tuple[int, ...]
    error_px: float

    def share(self, threshold: int = 0) -> float:
        """Share of query points within a threshold.

        Half a query is counted as correct and half as wrong in addition, to keep ratios finite.
        """
        return (self.within[threshold] + 0.5) / (self.queries + 1)


def line_distances(F: Float, uv_a: Float, uv_b: Float) -> Float:
    """Distances (N,) px of matches (N, 2) from their epipolar lines.

    Of the distances in both pictures the larger one counts.
    """
    x_a, x_b = epipolar.homogeneous(uv_a), epipolar.homogeneous(uv_b)
    lines_b, lines_a = x_a @ F.T, x_b @ F
    value = np.abs((x_b * lines_b).sum(1))
    least = np.minimum(*(np.linalg.norm(lines[:, :2], axis=1) for lines in (lines_a, lines_b)))
    return np.asarray(value / np.maximum(least, 1e-300))


def pairs(clip: Clip, folder: Path) -> Iterator[RealPair]:
    """Yield the picture pairs of a clip: both eyes, and keyframes if the clip is posed.

    Raises CalmEdgeError.
    """
    truth, sequence = read_truth(folder), SequenceFolder(folder)
    if truth.cameras is None:
        raise EvaluationError(f"{folder}: no calib.txt, which holds the true cameras")
    T_p_a = np.eye(4)
    T_p_a[0, 3] = clip.spacing_m
    F_eyes = epipolar.from_motion(*truth.cameras, se3.inverse(T_p_a))
    files = [pictures(folder, eye) for eye in (0, 1)]
    for place, frame in enumerate(places(min(map(len, files)), PLACES)):
        a, b = (read_picture(files[eye][frame]) for eye in (0, 1))
        yield RealPair("eyes", clip.name, place, a, b, F_eyes)
        chosen = keyframes(sequence, files[0], frame) if clip.posed else []
        for gap in (g for g in GAPS if g < len(chosen)):
            T_b_a = se3.inverse(truth.T_w_c[chosen[gap]]) @ truth.T_w_c[frame]
            F = epipolar.from_motion(truth.cameras[0], truth.cameras[0], T_b_a)
            yield RealPair(f"{gap} on", clip.name, place, a, read_picture(files[0][chosen[gap]]), F)


def measure_pair(pair: RealPair, matchers: Mapping[str, Matcher]) -> list[LineScore]:
    """Score all matchers at the same query points, half of them SIFT keypoints, half corners."""
    uv = np.concatenate([points[:QUERIES] for points in candidates(pair.a, pair.place)])
    if len(uv) < MIN_QUERIES:
        return []
    return [
        LineScore(name, pair.clip, pair.case, pair.place, len(uv), *judge(found, uv, pair.F))
        for name, found in (
            (name, each.match(pair.a, pair.b, uv)) for name, each in matchers.items()
        )
    ]


def judge(matches: Matches, uv: Float, F: Float) -> tuple[int, tuple[int, ...], float]:
    """Compute `found`, `within` and `error_px` of LineScore for query points uv (N, 2) px."""
    ok = matches.found
    off = line_distances(F, uv[ok], matches.uv_b[ok])
    near = off[off <= THRESHOLDS_PX[-1]]
    error = float(np.median(near)) if len(near) else float("nan")
    return int(ok.sum()), tuple(int((off <= limit).sum()) for limit in THRESHOLDS_PX), error


COLUMNS = (
    "clip", "case", "matcher", "found %", "1 px %", "3 px %", "of found 1 px %", "error px",
    "queries",
)  # fmt: skip


def rows(scores: Sequence[LineScore]) -> list[tuple[Any, ...]]:
    """Table rows, one for each clip, case and matcher.

    Shares [percent] are over the query points of all pairs.
    """
    out: list[tuple[Any, ...]] = []
    for clip, case, name in dict.fromkeys((s.clip, s.case, s.matcher) for s in scores):
        own = [s for s in scores if (s.clip, s.case, s.matcher) == (clip, case, name)]
        queries, found = sum(s.queries for s in own), sum(s.found for s in own)
        near = [sum(s.within[k] for s in own) for k in range(len(THRESHOLDS_PX))]
        errors = [s.error_px for s in own if np.isfinite(s.error_px)]
        out.append((
            clip, case, name, *(round(100 * n / queries, 1) for n in (found, *near)),
            round(100 * near[0] / found, 1) if found else None,
            float(np.median(errors)) if errors else None, queries,
        ))  # fmt: skip
    return sorted(out, key=lambda row: (row[0], row[1]))


def requirements(scores: Sequence[LineScore], others: Sequence[str]) -> tuple[Check, ...]:
    """Requirement that ours finds more than each other matcher in all cases, at both thresholds."""
    checks = []
    for case in dict.fromkeys(score.case for score in scores):
        for other in others:
            for threshold, px in enumerate(THRESHOLDS_PX):
                theirs, mine = (
                    {
                        (s.clip, s.place): s.share(threshold)
                        for s in scores
                        if (s.matcher, s.case) == (name, case)
                    }
                    for name in (other, OURS)
                )
                ratio = compare(theirs, mine) if theirs.keys() & mine.keys() else None
                what = f"{case}: share of {other} within {px:g} px of the line, over ours"
                checks += ratio_check(what, ratio, 1.0)
    return tuple(checks)


def table(scores: Sequence[LineScore], notes: Sequence[str]) -> Table:
    """Table of the shares by clip and case, with the requirements if ours is measured."""
    names = list(dict.fromkeys(score.matcher for score in scores))
    return Table(
        "53_model_real_clips",
        "Correspondences on real clips, by true epipolar lines",
        "python -m bench model.clips",
        COLUMNS,
        tuple(rows(scores)),
        requirements(scores, [n for n in names if n != OURS]) if OURS in names else (),
        (
            "shares of all query points, visible in the other picture or not; distance: the larger "
            "of both pictures; error px: median of those within 3 px",
            "between keyframes only on clips with camera poses, whose rotation errors affect all "
            "matchers alike",
            "the interval of a case with one clip is over the places of that clip alone",
            *notes,
        ),
    )


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command to `parser`."""
    parser.add_argument("--ours", metavar="MODULE:FACTORY", help="another learned matcher")
    parser.add_argument("--only", action="append", choices=[clip.name for clip in CLIPS])
    parser.add_argument("--data", type=Path, default=DATA, help="where the clips lie")
    parser.add_argument("--out", type=Path, default=OUT)


def run(options: argparse.Namespace) -> int:
    """Measure, print and save the table; return 1 if a requirement is not met."""
    scores: list[LineScore] = []
    matchers: dict[str, Matcher] = {name: make() for name, make in BASELINES.items()}
    ours, missing = contestant(options.ours, "match")
    if ours is not None:
        matchers = {OURS: ours, **matchers}
    notes = [missing] if missing else []
    clips = {clip.name: clip for clip in CLIPS}
    drives = {name: there(options.data / name) for name in clips}
    for name, folder in prepared(drives, options.only, options.out, notes):
        for pair in pairs(clips[name], folder):
            scores += measure_pair(pair, matchers)
    return publish(table(scores, notes), options.out)
