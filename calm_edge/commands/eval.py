"""`calm-edge eval`: measure the error against ground truth."""

from __future__ import annotations

import argparse
from pathlib import Path

from calm_edge.commands.console import say, say_no_metre
from calm_edge.commands.exit_codes import LOSS, OK


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
    """Print the error metrics; return 3 without poses or without the metre."""
    from calm_edge.evaluation.results import evaluate
    from calm_edge.evaluation.table import json_text, print_result

    figures = evaluate(arguments.target, arguments.truth, arguments.align)
    if arguments.json:
        print(json_text(figures))
    else:
        print_result(figures, str(arguments.target))
    code = OK
    if not figures["poses"]:
        say(f"loss: {arguments.target}: there are no poses to compare with the truth")
        code = LOSS
    elif not figures["truth_moves"]:
        say(
            f"loss: {arguments.truth}: the truth does not move (path {figures['path_m']:.2f} m): "
            "an error of the path cannot be given"
        )
        code = LOSS
    reason = (figures["metre"] or {}).get("reason")
    if figures["spacing_m"] and reason:
        say_no_metre(reason)
        code = LOSS
    return code
