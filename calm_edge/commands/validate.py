"""`calm-edge validate`: check a recording for damage."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING

from calm_edge.commands.console import say

if TYPE_CHECKING:
    from calm_edge.recording.recovery import RecordingReport


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("recording", type=Path, help="a recording folder or an MCAP file")
    add_json(parser)


def add_json(parser: argparse.ArgumentParser) -> None:
    """Add the argument for programs that read the report."""
    parser.add_argument("--json", action="store_true", help="the report as JSON on stdout")


def run(arguments: argparse.Namespace) -> int:
    """Check every chunk; return 3 if some messages are lost, 1 if nothing can be read."""
    from calm_edge.recording.recovery import validate

    return print_report(validate(arguments.recording), as_json=arguments.json)


def print_report(report: RecordingReport, *, as_json: bool) -> int:
    """Print the counts to stdout and the losses to stderr; return the exit code.

    as_json: all of it as one JSON object.
    """
    if as_json:
        table = {
            "outcome": report.outcome.name.lower(),
            "files": [str(file) for file in report.files],
            "messages": report.messages,
            "losses": list(report.losses),
        }
        print(json.dumps(table, indent=1))
        return int(report.outcome)
    for file in report.files:
        print(file)
    for topic, count in sorted(report.messages.items()):
        print(f"{topic:20} {count}")
    for line in report.losses:
        say(line)
    return int(report.outcome)
