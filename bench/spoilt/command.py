"""Record drives that mislead: one camera twice, wrong stamps, a parked car, a short straight start.

Each has to end with the right metre, or with none and a sentence that says why. The inputs are made
from the demo drive and from karlsruhe_town; outcomes are kept in build/outcomes by the state of the
code.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bench.lottery.command import versions
from bench.spoilt.cases import BASES, CASES
from bench.spoilt.outcome import Spoilt, spoilt
from bench.tables import OUT, Check, Table, publish
from calm_edge.evaluation import EvaluationError

COLUMNS = (
    "drive",
    "case",
    "version",
    "exit",
    "path m",
    "true m",
    "sigma %",
    "poses",
    "lost",
    "ODOMETRY",
    "quality",
    "states",
    "last line",
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("--only", action="append", choices=[c.name for c in CASES], metavar="CASE")
    parser.add_argument("--drive", action="append", choices=[b.name for b in BASES])
    parser.add_argument("--against", type=Path, metavar="CHECKOUT", help="the version to compare")
    parser.add_argument("--out", type=Path, default=OUT)


def run(options: argparse.Namespace) -> int:
    """Record all cases, print and save the table; 1 if this version gives a wrong metre."""
    found, notes = [], []
    for base in BASES:
        if options.drive and base.name not in options.drive:
            continue
        if not (base.folder / "cam1").is_dir():
            notes.append(f"{base.folder} is not here")
            continue
        for case in CASES:
            if options.only and case.name not in options.only:
                continue
            for name, checkout in versions(options):
                try:
                    found.append((name, spoilt(base, case, checkout)))
                except EvaluationError as error:
                    notes.append(str(error))
                    continue
                print(f"{name}: {progress(found[-1][1])}", file=sys.stderr, flush=True)
    return publish(table(options.command, found, notes), options.out)


def progress(one: Spoilt) -> str:
    """One line on a case."""
    path = f"{one.path_m:.1f} m of {one.true_m:.1f}"
    return f"{one.drive} {one.case}: exit {one.exit_code}, {path}, {one.odometry} ODOMETRY"


def table(command: str, found: Sequence[tuple[str, Spoilt]], notes: Sequence[str]) -> Table:
    """Table of all cases, with the requirement on this version."""
    checks = tuple(
        Check(
            f"{one.drive}, {one.case}",
            "right within 3 sigma, or no metre",
            f"{one.path_m:.1f} m of {one.true_m:.1f}" if one.claims else "no metre",
            one.right,
        )
        for name, one in found
        if name == "this"
    )
    rows = tuple(_row(name, one) for name, one in found)
    said = "no metre: exit code 3 and no ODOMETRY on the serial line"
    return Table("spoilt", "Drives that mislead", command, COLUMNS, rows, checks, (said, *notes))


def _row(name: str, one: Spoilt) -> tuple[Any, ...]:
    return (
        one.drive,
        one.case,
        name,
        one.exit_code,
        one.path_m,
        one.true_m,
        None if one.scale_sigma is None else 100 * one.scale_sigma,
        one.live,
        one.lost,
        one.odometry,
        one.quality,
        " ".join(one.states),
        one.said,
    )
