"""Compute the paper's tables on a published dataset.

Each sequence is recorded, optionally mapped, and evaluated.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from calm_edge.commands.exit_codes import ERROR, OK

NAMES = ("kitti-odom", "kitti-360", "argoverse")


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command to `parser`."""
    parser.add_argument("dataset", choices=NAMES)
    parser.add_argument("root", type=Path, metavar="ROOT", help="the folder it was unpacked into")
    parser.add_argument(
        "--sequence", action="append", metavar="NAME", help="one of its sequences; default: all"
    )
    parser.add_argument(
        "--async",
        dest="asynchronous",
        action="store_true",
        help="odd frames to the primary camera, even frames to the assistant",
    )
    parser.add_argument(
        "--frames", type=int, metavar="N", help="the first N pairs; default: the paper's"
    )
    parser.add_argument("--map", dest="dense", action="store_true", help="also make a dense map")
    parser.add_argument(
        "--metric", action="store_true", help="give `record` the published spacing: metres"
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="SECTION.KEY=VALUE",
        help="override the configuration of `record`",
    )
    parser.add_argument(
        "--out", type=Path, default=Path("build/datasets"), metavar="DIR", help="where to work"
    )
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout")


def run(arguments: argparse.Namespace) -> int:
    """Run each sequence, print a table row for each and the average; return 1 if one failed."""
    from bench.datasets import table
    from calm_edge.evaluation.table import json_text
    from calm_edge.interchange.published import DatasetError

    if arguments.frames is not None and arguments.frames < 2:
        raise DatasetError(f"--frames {arguments.frames}: at least 2 pairs are needed")
    dataset = table.DATASETS[arguments.dataset]
    names = arguments.sequence or dataset.sequences(arguments.root)
    settings = tuple(word for change in arguments.set for word in ("--set", change))
    wanted = table.Wanted(
        arguments.asynchronous, arguments.frames, arguments.dense, arguments.metric, settings
    )
    out = arguments.out / arguments.dataset / ("async" if arguments.asynchronous else "sync")
    if not arguments.json:
        print(table.heading(arguments.dense), flush=True)
    rows = {}
    for name, figures in table.measured(dataset, arguments.root, names, wanted, out):
        rows[name] = figures
        for note in figures.get("notes", ()):
            print(f"bench: {name}: {note}", file=sys.stderr)
        if not arguments.json:
            print(table.row(name, figures, arguments.dense), flush=True)
    done = [figures for figures in rows.values() if "failed" not in figures]
    mean = table.average(done)
    if arguments.json:
        print(json_text({"sequences": rows, "average": mean}))
    elif len(rows) > 1:
        print(table.row("average", mean, arguments.dense))
    return OK if len(done) == len(rows) else ERROR
