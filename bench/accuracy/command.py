"""Accuracy of `record`: four conditions on three tracks with two seeds each, and real clips.

Errors of different drives differ by factors, so they are averaged as geometric means; see
`bench.paired` for the intervals. Outcomes are kept in build/outcomes by the state of the code.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bench import paired
from bench.accuracy.drives import (
    CONDITIONS,
    HINTED,
    NARROW,
    PART,
    SEEDS,
    TRACKS,
    WHOLE,
    rendered,
)
from bench.accuracy.real import measured
from bench.lottery.command import versions
from bench.outcome import outcomes
from bench.tables import OUT, Check, Table, publish

COLUMNS = (
    "condition",
    "version",
    f"{TRACKS[0]} {SEEDS[0]}, %",
    "geometric mean, %",
    "95 % from",
    "to",
    "failed",
    "over the other",
    "95 % from",
    "to",
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("--only", choices=["rendered", "real"])
    parser.add_argument("--condition", action="append", choices=list(CONDITIONS))
    parser.add_argument("--track", action="append", choices=TRACKS)
    parser.add_argument("--against", type=Path, metavar="CHECKOUT", help="the version to compare")
    parser.add_argument("--out", type=Path, default=OUT)


def run(options: argparse.Namespace) -> int:
    """Run the drives, print and save the tables; return 1 if this version misses a requirement."""
    missed = 0
    if options.only != "real":
        conditions, tracks = options.condition or CONDITIONS, options.track or TRACKS
        drives = {
            name: [(track, seed) for track in tracks for seed in SEEDS] for name in conditions
        }
        errors = {
            version: {name: _errors(name, some, checkout) for name, some in drives.items()}
            for version, checkout in versions(options)
        }
        missed |= publish(rendered_table(options.command, errors), options.out)
    if options.only != "rendered":
        for version, checkout in versions(options):
            trials = (WHOLE, PART, HINTED, NARROW)
            found = {one.drive: one for one in outcomes(trials, checkout)}
            rows, checks = measured(found, checkout)
            title = f"Accuracy on real clips and with cameras 0.2 m apart, {version}"
            name, columns = f"accuracy_real_{version}", ("figure", "value", "note")
            judged = publish(
                Table(name, title, options.command, columns, tuple(rows), tuple(checks)),
                options.out,
            )
            missed |= judged if version == "this" else 0
    return missed


def _errors(
    condition: str, drives: Sequence[tuple[str, int]], checkout: Path
) -> dict[tuple[str, int], float | None]:
    """ATE in percent of the path of each drive under a condition; None after a failure."""
    found = outcomes((rendered(condition, *drive) for drive in drives), checkout)
    return {drive: one.ate_percent for drive, one in zip(drives, found, strict=True)}


def rendered_table(command: str, errors: Mapping[str, Mapping[str, paired.Errors]]) -> Table:
    """Table of the rendered drives. errors: ATE by version, condition and drive."""
    rows: list[tuple[Any, ...]] = []
    checks: list[Check] = []
    first = (TRACKS[0], SEEDS[0])
    for condition in errors["this"]:
        for version, by_condition in errors.items():
            some = by_condition[condition]
            mean = paired.geometric_mean(some)
            other: tuple[Any, ...] = (None, None, None)
            if version == "this" and "against" in errors:
                ratio = paired.compare(some, errors["against"][condition])
                other = (ratio.ratio, ratio.low, ratio.high)
            figures = (mean.ratio, mean.low, mean.high, mean.failed)
            rows.append((condition, version, some.get(first), *figures, *other))
        value, most = errors["this"][condition].get(first), CONDITIONS[condition][1]
        if first in errors["this"][condition]:
            what = f"{first[0]}, seed {first[1]}, {condition}: ATE, %"
            checks.append(Check(what, f"<= {most:g}", value, value is not None and value <= most))
    n = max(len(some) for some in errors["this"].values())
    notes = (f"SE(3) ATE in percent of the path; geometric means over {n} drives",)
    title = "Accuracy on rendered drives"
    return Table("accuracy_rendered", title, command, COLUMNS, tuple(rows), tuple(checks), notes)
