"""`calm-edge compare`: list what differs between two recordings or maps."""

from __future__ import annotations

import argparse
from itertools import groupby
from pathlib import Path

from calm_edge.commands.console import say
from calm_edge.commands.exit_codes import LOSS, OK


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    for name in ("a", "b"):
        parser.add_argument(name, type=Path, help="a recording, a map folder or a TUM file")
    parser.add_argument(
        "--truth",
        type=Path,
        metavar="FOLDER",
        help="true poses of both; default: those of an imported recording",
    )
    parser.add_argument("--out", type=Path, metavar="FILE", help="write a page (HTML) as well")
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout")


def run(arguments: argparse.Namespace) -> int:
    """Print both sides' figures and their differences; return 3 if a side is not complete."""
    from calm_edge.evaluation.difference import overlay, plain, rows
    from calm_edge.evaluation.side import read_side
    from calm_edge.evaluation.table import aligned, json_text
    from calm_edge.report.comparison_page import apart, render, rows_unit
    from calm_edge.types import CalmEdgeError

    sides = [read_side(path, arguments.truth) for path in (arguments.a, arguments.b)]
    found, placed = rows(*sides), overlay(*sides)
    if arguments.json:
        print(json_text(plain(*sides)))
    else:
        for group, members in groupby(found, key=lambda row: row.figure.group):
            lines = aligned((row.cells() for row in members), (group, "A", "B", "change"))
            print("\n".join([*lines, ""]))
        print(apart(placed, rows_unit(found)))
    if arguments.out is not None:
        try:
            text = render(sides[0], sides[1], found, placed)
            arguments.out.write_text(text, encoding="utf-8", errors="replace")
        except OSError as error:
            raise CalmEdgeError(f"{arguments.out}: cannot be written ({error.strerror})") from None
        say(f"page: {arguments.out}")
    for side in sides:
        for line in side.missing:
            say(f"loss: {side.path}: {line}")
    return LOSS if any(side.missing for side in sides) else OK
