"""Record and evaluate randomly drawn rendered drives: trajectories, focals, scale and sigmas.

Outcomes are kept in build/outcomes by the state of the code, so that a run can be resumed. dirt-1
is none of the tracks, see `draw`.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from bench.drives import ROOT
from bench.lottery.draw import KINDS, draw
from bench.lottery.requirements import LIMITS, requirements
from bench.outcome import Outcome, outcomes
from bench.tables import OUT, Table, publish

COLUMNS = (
    "drive",
    "yaw",
    "ATE %",
    "scale error %",
    "sigma %",
    "placed %",
    "garbage %",
    "metric %",
    "garbage of metric %",
    "focal errors %",
    "sigmas %",
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_draw(parser)
    parser.add_argument("--out", type=Path, default=OUT)


def add_draw(parser: argparse.ArgumentParser) -> None:
    """Add the arguments that say which drives are drawn, and whose code records them."""
    parser.add_argument("--n", type=int, default=12, help="number of drives")
    parser.add_argument("--seed", type=int, default=1, help="another seed draws other drives")
    parser.add_argument("--kind", choices=KINDS, default="plain")
    parser.add_argument("--against", type=Path, metavar="CHECKOUT", help="the version to compare")


def versions(options: argparse.Namespace) -> list[tuple[str, Path]]:
    """The versions of the code to measure: name and checkout, the one to compare with first."""
    both = (("against", options.against), ("this", ROOT))
    return [(name, path.resolve()) for name, path in both if path is not None]


def run(options: argparse.Namespace) -> int:
    """Record and evaluate all drives, print and save a table for each version of the code.

    Returns 1 if this version misses a requirement.
    """
    missed = 0
    for name, checkout in versions(options):
        drawn = (draw(options.seed, k, options.kind) for k in range(options.n))
        found = outcomes(drawn, checkout)
        missed = publish(_table(name, options, found), options.out)
    return missed


def _table(version: str, options: argparse.Namespace, found: list[Outcome]) -> Table:
    rows = tuple(_row(one) for one in found)
    without = sum(one.ate_percent is None for one in found)
    note = (
        f"{len(found)} drives, {without} without a result: wholly garbage, of an infinite ATE; "
        "garbage is counted among the steps between keyframes of one sub-map; metric are keyframes "
        "of sub-maps that claim a metre, the live pose of others is DEGRADED"
    )
    kind, checks = options.kind, requirements(found, LIMITS[options.kind])
    title, name = f"Lottery of {kind} drives, {version}", f"lottery_{kind}_{version}"
    return Table(name, title, options.command, COLUMNS, rows, checks, (note,))


def _row(one: Outcome) -> tuple[Any, ...]:
    return (
        one.drive.removeprefix("lottery_"),
        one.yaw_deg,
        one.failed or one.ate_percent,
        None if one.scale_error is None else 100 * one.scale_error,
        None if one.scale_sigma is None else 100 * one.scale_sigma,
        100 * one.placed,
        100 * one.garbage,
        100 * one.metric,
        100 * one.garbage_of_metric,
        _percent(one.focal_error),
        _percent(one.focal_sigma),
    )


def _percent(logs: tuple[float, float] | None) -> str:
    return "" if logs is None else " ".join(f"{100 * value:.1f}" for value in logs)
