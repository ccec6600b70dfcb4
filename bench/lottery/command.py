"""Record and evaluate randomly drawn rendered drives: trajectories, focals and their sigmas."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

from bench.drives import ROOT
from bench.lottery.draw import draw
from bench.lottery.outcome import Outcome, outcome
from bench.tables import OUT, Table, publish
from calm_edge.evaluation.results import MAX_FOCAL_SIGMA_PERCENT

COLUMNS = ("drive", "yaw", "ATE %", "scale %", "placed %", "garbage %", "focals %", "sigmas %")
TURNING_DEG = 15.0


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("--n", type=int, default=12, help="number of drives")
    parser.add_argument("--seed", type=int, default=1, help="another seed draws other drives")
    parser.add_argument("--kind", choices=["plain"], default="plain")
    parser.add_argument("--against", type=Path, metavar="CHECKOUT", help="the version to compare")
    parser.add_argument("--out", type=Path, default=OUT)


def run(options: argparse.Namespace) -> int:
    """Record and evaluate all drives, print and save a table for each version of the code."""
    for name, checkout in (("against", options.against), ("this", ROOT)):
        if checkout is None:
            continue
        found = []
        for number in range(options.n):
            found.append(outcome(draw(options.seed, number), checkout.resolve()))
            print(f"lottery: {name}, {found[-1]}", file=sys.stderr, flush=True)
        publish(_table(f"lottery_{name}", options.command, found), options.out)
    return 0


def _table(name: str, command: str, found: list[Outcome]) -> Table:
    rows = tuple(_row(one) for one in found)
    return Table(name, f"Lottery ({name})", command, COLUMNS, rows, notes=_summary(found))


def _row(one: Outcome) -> tuple[Any, ...]:
    return (
        one.drive.removeprefix("lottery_"),
        one.yaw_deg,
        one.failed or one.ate_percent,
        None if one.scale is None else 100 * (one.scale - 1),
        100 * one.placed,
        100 * one.garbage,
        _percent(one.focal_error),
        _percent(one.focal_sigma),
    )


def _percent(logs: tuple[float, float] | None) -> str:
    return "" if logs is None else " ".join(f"{100 * value:.1f}" for value in logs)


def _summary(found: list[Outcome]) -> tuple[str, ...]:
    """Notes below the table: figures over all drives."""
    done = [one for one in found if one.ate_percent is not None]
    ate = [one.ate_percent for one in done if one.ate_percent is not None]
    scale = [abs(one.scale - 1) for one in done if one.scale is not None]
    lines = [
        f"{len(done)} of {len(found)} drives with a result; garbage "
        f"{100 * np.mean([one.garbage for one in found]):.2f} % of the steps, placed "
        f"{100 * np.mean([one.placed for one in found]):.1f} % of the keyframes",
    ]
    if done:
        lines.append(
            f"ATE median {np.median(ate):.2f} %, worst {max(ate):.2f} %; scale error median "
            f"{100 * np.median(scale):.2f} %, worst {100 * max(scale):.2f} %"
        )
    lines.extend(_focals(done))
    return tuple(lines)


def _focals(done: list[Outcome]) -> list[str]:
    most = MAX_FOCAL_SIGMA_PERCENT / 100
    seen: list[float] = []
    turning = observed = 0
    for one in done:
        for error, sigma in zip(one.focal_error or (), one.focal_sigma or (), strict=True):
            turning += one.yaw_deg > TURNING_DEG
            observed += one.yaw_deg > TURNING_DEG and sigma <= most
            if sigma <= most:
                seen.append(error / sigma)
    if not seen:
        return ["no focal was observed"]
    size = np.abs(seen)
    return [
        f"focals with more than {TURNING_DEG:g} degrees of yaw: {observed} of {turning} observed",
        f"normalised errors of observed focals: rms {np.sqrt(np.mean(size**2)):.2f}, beyond 3 "
        f"{100 * np.mean(size > 3):.0f} %, beyond 5 {100 * np.mean(size > 5):.0f} % of {len(size)}",
    ]
