"""`calm-edge recover`: copy the intact part of a damaged recording."""

from __future__ import annotations

import argparse
from pathlib import Path

from calm_edge.commands.validate import add_json, print_report


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("recording", type=Path, help="a recording folder or an MCAP file")
    parser.add_argument(
        "--out", type=Path, help="a new folder, or a new file; by default beside the recording"
    )
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    """Copy the intact messages; return 3 if some were lost, 1 if nothing could be read."""
    from calm_edge.recording.recovery import default_target, recover

    source: Path = arguments.recording
    report = recover(source, arguments.out or default_target(source))
    return print_report(report, as_json=arguments.json)
