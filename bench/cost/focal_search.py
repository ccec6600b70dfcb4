"""Errors and computing time of the intrinsic search (paper V-A), by motion of the camera.

The search finds the focal length that best fits a bank of test groups, pixel matches in a few views
each. Errors are divided by the reported sigma. Scripted motions with 0.3 px of pixel noise and the
principal point drawn from its prior; the initial focal length is 10 % too long.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from time import process_time

import numpy as np

from bench.scripted.motions import CAMERA, SIZE, group
from bench.tables import OUT, Table, publish
from calm_edge.config import CorrectionConfig
from calm_edge.correction import bank_focal
from calm_edge.correction.spectral import PRINCIPAL_POINT_SHARE
from calm_edge.correction.test_bank import TestBank

GUESS = CAMERA.with_focal(1.1 * CAMERA.fx)
# Each entry: the motions of the groups in one bank, see `bench.scripted.motions.motion`.
BANKS = (
    ("general",),
    ("ahead", "-ahead"),
    ("general", "-ahead", "straight", "ahead", "-general"),
    ("tangent", "-tangent", "straight", "tangent", "tangent"),
)
COLUMNS = (
    "motions",
    "informative",
    "log error rms",
    "log sigma median",
    "error / sigma rms",
    "processor ms",
)


def row(kinds: Sequence[str], seeds: int) -> tuple[str | float | None, ...]:
    """Table row of one kind of bank: errors of the informative banks, and the median time.

    A bank holds the groups of matches searched together; it is informative if it determines the
    focal (sigma of the log at most 0.1). kinds: motions of the bank's groups. seeds: number of
    random banks.
    """
    found, milliseconds = [], []
    for seed in range(seeds):
        rng = np.random.default_rng([seed, len(kinds)])
        dx, dy = (rng.normal(size=2) * PRINCIPAL_POINT_SHARE * SIZE[0]).tolist()
        bank = TestBank(CorrectionConfig())
        for n, kind in enumerate(kinds):
            made = group(kind, seed * 10 + n, guess=GUESS.fx, off_px=(dx, dy))
            bank.add(made, np.log(GUESS.fx))
        start = process_time()
        found.append(bank_focal.minimise(bank, GUESS, GUESS.fx, weighted=True))
        milliseconds.append(1e3 * (process_time() - start))
    error = np.array([one.log_focal for one in found]) - np.log(CAMERA.fx)
    sigma = np.array([one.log_sigma for one in found])
    informative = np.isfinite(sigma)
    error, sigma = error[informative], sigma[informative]
    figures: tuple[float | None, ...] = (None,) * 3
    if len(error):
        ratio = error / sigma
        figures = tuple(
            map(float, (np.sqrt((error**2).mean()), np.median(sigma), np.sqrt((ratio**2).mean())))
        )
    count = f"{len(error)} of {seeds}"
    return (" ".join(kinds), count, *figures, float(np.median(milliseconds)))


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command to `parser`."""
    parser.add_argument("--seeds", type=int, default=200, help="banks of each kind")
    parser.add_argument("--out", type=Path, default=OUT)


def run(options: argparse.Namespace) -> int:
    """Run the searches, print and save the table, return the exit code."""
    title = "Focal lengths of the intrinsic search"
    rows = tuple(row(kinds, options.seeds) for kinds in BANKS)
    notes = ("error / sigma is 1 where the claimed sigma is right",)
    table = Table("bench_search", title, options.command, COLUMNS, rows, (), notes)
    return publish(table, options.out)
