"""Errors of single windows over the sigmas claimed for them: scale, and motion over a second.

Windows are solved by the localizer alone, without the processes of `record`. By default the drives
are those of `bench lottery`; others are named FOLDER:SPACING_M (a sequence folder with truth), or
RECORDING=FOLDER (a recording, whose windows are not solved again, and the truth).
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

from bench.kit_agreement import windows
from bench.lottery.command import add_draw
from bench.lottery.draw import draw
from bench.normalised import COLUMNS
from bench.tables import OUT, Check, Table, publish
from bench.window_errors import DriveErrors, drive_errors, table
from calm_edge.backbones.registry import open_backbone
from calm_edge.config import Config, merge, parse_assignment
from calm_edge.estimator.localizer import Localizer
from calm_edge.evaluation import EvaluationError
from calm_edge.evaluation.truth import read_truth
from calm_edge.recording.reader import Recording
from calm_edge.types import LocalizerUpdate


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("drives", nargs="*", metavar="DRIVE")
    add_draw(parser)
    parser.add_argument("--set", action="append", default=[], metavar="SECTION.KEY=VALUE")
    parser.add_argument("--out", type=Path, default=OUT)


def run(options: argparse.Namespace) -> int:
    """Measure all drives, print and save the table; 1 if a requirement is missed."""
    found = []
    for drive in options.drives or _drawn(options.seed, options.n):
        one = _recorded(drive) if "=" in drive else _solved(drive, options.set)
        found.append(one)
        print(_line(drive, one), file=sys.stderr, flush=True)
    rows = table(found)
    checks: list[Check] = []
    for row in rows:
        checks.extend(row.checks())
    return publish(
        Table(
            "windows", "single windows: errors over claimed sigmas", options.command, COLUMNS,
            tuple(row.row() for row in rows), tuple(checks),
        ),
        options.out,
    )  # fmt: skip


def _drawn(seed: int, n: int) -> Iterator[str]:
    for number in range(n):
        drive = draw(seed, number)
        folder = drive.prepare(OUT)
        if isinstance(folder, str):
            raise EvaluationError(f"{drive.name}: {folder}")
        yield f"{folder}:{drive.options[1]}"


def _solved(drive: str, assignments: list[str]) -> DriveErrors:
    """Solve the windows of FOLDER:SPACING_M."""
    name, _, spacing = drive.rpartition(":")
    try:
        spacing_m = float(spacing)
    except ValueError:
        raise EvaluationError(f"{drive}: name the spacing too, as FOLDER:SPACING_M") from None
    config = merge(Config(), {"scale": {"spacing_m": spacing_m}, "loops": {"enabled": False}})
    for text in assignments:
        config = merge(config, parse_assignment(text))
    localizer = Localizer(config, open_backbone(config))
    updates = [localizer.process(window) for window in windows(Path(name), config)]
    localizer.finish()
    solved = [update for update in updates if update is not None]
    truth = read_truth(Path(name))
    return drive_errors(solved, localizer.submaps, localizer.metre, truth, spacing_m)


def _recorded(drive: str) -> DriveErrors:
    """Read the windows of RECORDING=FOLDER."""
    name, _, folder = drive.partition("=")
    recording = Recording(Path(name))
    spacing_m = recording.config.scale.spacing_m
    if not spacing_m:
        raise EvaluationError(f"{name}: recorded without scale.spacing_m")
    first: dict[int, LocalizerUpdate] = {}
    last: dict[int, LocalizerUpdate] = {}
    for update in recording.updates():
        first.setdefault(update.submap.id, update)
        last[update.submap.id] = update
    if not first:
        raise EvaluationError(f"{name}: holds no sub-map")
    submaps = [update.submap for update in last.values()]
    metre = list(last.values())[-1].metre
    return drive_errors(list(first.values()), submaps, metre, read_truth(Path(folder)), spacing_m)


def _line(drive: str, one: DriveErrors) -> str:
    error, sigma = one.whole
    return (
        f"{drive}: {len(one.first)} windows, log length {100 * error:+.2f} %"
        f" (sigma {100 * sigma:.2f} %)"
    )
