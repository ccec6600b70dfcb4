"""Correspondences of the learned matcher and of classical ones, with the requirements on them.

Rendered drives give the exact truth. Of all query points visible in the other picture, the shares
found within one and three pixels are listed. The shipped model is measured if it is installed;
`--ours MODULE:FACTORY` names another one.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path

from bench.model import scenes
from bench.model.correspondences import (
    COLUMNS,
    Score,
    against,
    measure,
    retained_against,
    rows,
)
from bench.model.degrade import DEGRADATIONS
from bench.model.matchers import BASELINES
from bench.model.ours import OURS, add_arguments, contestant
from bench.model.protocols import Matcher
from bench.paired import PairedRatio
from bench.tables import Check, Table, publish
from calm_edge.evaluation import EvaluationError

# Factor by which ours shall find more matches than another matcher between eyes that differ by 20
# degrees of roll and a factor of two in focal length.
HARD_GAIN = 1.5
# This matcher finds up to two thirds of the points there, starting from SIFT matches, so HARD_GAIN
# times as many is out of reach: a factor of 1 suffices against it.
HELPED = "KLT warped"


def table(
    matchers: Mapping[str, Matcher],
    held_out: bool,
    only: Sequence[str] | None,
    out: Path,
    missing: str = "",
) -> Table:
    """Measure on development or held-out drives and make the table.

    only: names of drives, all if empty. missing: note on why our model is not measured. Raises
    EvaluationError if nothing could be measured.
    """
    chosen = scenes.UNSEEN + scenes.HARD_UNSEEN if held_out else scenes.DEVELOPMENT + scenes.HARD
    unknown = set(only or ()) - {scene.name for scene in chosen}
    if unknown:
        known = ", ".join(scene.name for scene in chosen)
        raise EvaluationError(f"--only {sorted(unknown)[0]}: no such drive; known: {known}")
    wanted = [scene for scene in chosen if not only or scene.name in only]
    scores, skipped = measure(wanted, matchers, out)
    if not scores:
        raise EvaluationError("; ".join(skipped) or "no pair had enough query points")
    others = [name for name in matchers if name != OURS]
    checks = requirements(scores, others) if OURS in matchers else ()
    notes = (
        "over query points visible in the other picture; half are SIFT keypoints, half Shi-Tomasi "
        "corners, detected on the clean picture",
        "error px: median of those within 3 px; error / sigma: 1 where the claimed sigma is honest",
        "KLT tracks from one picture directly to the other, also over 8 keyframes; bundle chains",
        *skipped,
        *([missing] if missing else []),
    )
    return Table(
        f"50_model_matches{'_held_out' if held_out else ''}",
        f"Correspondences{' on held-out drives' if held_out else ''}",
        f"python -m bench model.matches{' --held-out' if held_out else ''}",
        COLUMNS,
        tuple(rows(scores)),
        checks,
        notes,
    )


def requirements(scores: Sequence[Score], others: Sequence[str]) -> tuple[Check, ...]:
    """Requirements on our model against each other matcher.

    For every kind of pair it finds more correct matches, and a larger share of these also on
    degraded pictures (night, motion blur, JPEG).
    """
    checks = []
    for case in dict.fromkeys(score.case for score in scores):
        for other in others:
            asked = 1 / HARD_GAIN if "°" in case and other != HELPED else 1.0
            for threshold, px in enumerate((1, 3)):
                ratio = against(scores, OURS, other, case, threshold)
                what = f"{case}: share of {other} within {px} px over ours"
                checks += ratio_check(what, ratio, asked)
    for degraded in DEGRADATIONS:
        for other in others:
            ratio = retained_against(scores, OURS, other, degraded)
            checks += ratio_check(f"{degraded}: share that {other} keeps, over ours", ratio, 1.0)
    return tuple(checks)


def ratio_check(what: str, ratio: PairedRatio | None, most: float) -> list[Check]:
    """Requirement that a ratio is at most `most` and its 95 % interval lies below 1.

    Empty list without a ratio.
    """
    if ratio is None or ratio.ratio is None or ratio.low is None or ratio.high is None:
        return []
    measured = f"{ratio.ratio:.3f} ({ratio.low:.3f} to {ratio.high:.3f}), {ratio.pairs} pairs"
    kept = ratio.verdict == "better" and ratio.within(most)
    return [Check(what, f"<= {most:.2f}, interval below 1", measured, kept)]


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command to `parser`."""
    add_arguments(parser, "matcher")
    parser.add_argument("--matcher", action="append", choices=list(BASELINES))


def run(options: argparse.Namespace) -> int:
    """Measure, print and save the table; return 1 if a requirement is not met."""
    matchers = {name: BASELINES[name]() for name in options.matcher or BASELINES}
    ours, missing = contestant(options.ours, "match")
    if ours is not None:
        matchers = {OURS: ours, **matchers}
    made = table(matchers, options.held_out, options.only, options.out, missing)
    return publish(made, options.out)
