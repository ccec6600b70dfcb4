"""`calm-edge eval`: measure the error against ground truth."""

from __future__ import annotations

import argparse
from pathlib import Path

from calm_edge.commands.console import LOSS, OK, say_no_metre


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("target", type=Path, help="a recording, a map folder or a TUM file")
    parser.add_argument("--truth", type=Path, required=True, metavar="FOLDER")
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout")
    parser.add_argument(
        "--align",
        choices=("se3", "sim3"),
        help="alignment for the percentages and the map; default: se3 if the spacing was given",
    )


def run(arguments: argparse.Namespace) -> int:
    """Print the error metrics; return 3 if the spacing was given and lengths are not metric."""
    from calm_edge.evaluation.results import evaluate
    from calm_edge.evaluation.table import json_text, print_result

    figures = evaluate(arguments.target, arguments.truth, arguments.align)
    if arguments.json:
        print(json_text(figures))
    else:
        print_result(figures, str(arguments.target))
    reason = (figures["metre"] or {}).get("reason")
    if not (figures["spacing_m"] and reason):
        return OK
    say_no_metre(reason)
    return LOSS
