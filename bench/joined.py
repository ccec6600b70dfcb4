"""Map two drives as one: are they joined, or apart, and how far are both off in one frame?

Both are imported from sequence folders, so that `map` solves them, and mapped together with their
truths. With --apart the drives show no common place, and `map` has to say so. The error of both in
one frame is measured where the true poses are in one frame.
"""

from __future__ import annotations

import argparse
import json
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bench import steps
from bench.drives import ROOT
from bench.process import last_line
from bench.tables import OUT, Check, Table, publish
from calm_edge.commands.exit_codes import LOSS, OK
from calm_edge.evaluation import EvaluationError

COLUMNS = "drive", "apart", "keyframes", "ATE m alone", "in one frame", "scale"
LEAST_PLACES, LARGEST_RATIO = 2, 1.5


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("folder", type=Path, nargs=2, help="sequence folders, with poses0.txt")
    parser.add_argument("--spacing-m", type=float, default=0.55, metavar="X")
    parser.add_argument("--apart", action="store_true", help="the drives show no common place")
    parser.add_argument("--quality", default="preview", help="of the map")
    parser.add_argument("--out", type=Path, default=OUT)


def run(options: argparse.Namespace) -> int:
    """Import and map both, print and save the table; 1 if a requirement is not met."""
    folders = [folder.resolve() for folder in options.folder]
    names = [f"{n}-{folder.name}" for n, folder in enumerate(folders)]
    place = ROOT / "build" / "joined" / "+".join(names)
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir(parents=True)
    for name, folder in zip(names, folders, strict=True):
        spacing = ("--spacing-m", f"{options.spacing_m:g}")
        steps.calm_edge("import", str(folder), "--out", str(place / name), *spacing)
    out = place / "map"
    given = [text for folder in folders for text in ("--truth", str(folder))]
    made = steps.process(
        *("map", *(str(place / name) for name in names), "--out", str(out)),
        *("--quality", options.quality, *given),
    )
    if made.returncode not in (OK, LOSS):
        raise EvaluationError(f"calm-edge map: exit {made.returncode}: {last_line(made)}")
    content = json.loads((out / "summary.json").read_text())
    alone = [
        steps.figures(out / "drives" / name, folder).get("ate_se3_m")
        for name, folder in zip(names, folders, strict=True)
    ]
    summaries = [json.loads((out / "drives" / n / "summary.json").read_text()) for n in names]
    error = content["error"]
    together = [None, None] if error is None else error["by_drive"]
    rows = tuple(
        (drive["name"], drive["apart"], own["keyframes"], ate, both, drive["scale"])
        for drive, own, ate, both in zip(content["drives"], summaries, alone, together, strict=True)
    )
    reported = f"{names[1]}: is apart: no place of the others was recognised in it" in made.stderr
    checks = (
        apart_checks(content, made.returncode, reported=reported)
        if options.apart
        else joined_checks(content, alone)
    )
    title = "Two drives in one map"
    return publish(Table("joined", title, options.command, COLUMNS, rows, checks), options.out)


def apart_checks(content: Mapping[str, Any], code: int, *, reported: bool) -> tuple[Check, ...]:
    """Requirements on drives without a common place. reported: by a line on stderr."""
    places = sum(row["closures"] for row in content["joined"])
    apart = [drive["apart"] for drive in content["drives"]]
    return (
        Check("places in common", "0", places, places == 0),
        Check("apart", "the second one", apart, apart == [False, True]),
        Check("reported in a line", "yes", reported, reported),
        Check("exit code", str(LOSS), code, code == LOSS),
    )


def joined_checks(content: Mapping[str, Any], alone: Sequence[float | None]) -> tuple[Check, ...]:
    """Requirements on drives of one place. alone: ATE [m] of each."""
    places = sum(row["closures"] for row in content["joined"])
    checks = [Check("places in common", f">= {LEAST_PLACES}", places, places >= LEAST_PLACES)]
    known = [ate for ate in alone if ate is not None]
    if content["error"] is not None and known:
        ratio = content["error"]["ate_m"] / max(known)
        asked = f"<= {LARGEST_RATIO:g} times the worse one alone"
        checks.append(Check("ATE in one frame", asked, ratio, ratio <= LARGEST_RATIO))
    return tuple(checks)
