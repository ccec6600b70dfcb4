"""`calm-edge keep`: protect a recording from removal when the disk is full."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from calm_edge.commands.exit_codes import OK


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("recording", type=Path, nargs="+", help="a recording folder")
    parser.add_argument(
        "--release", action="store_true", help="remove the mark: it may be deleted to make room"
    )
    parser.add_argument("--json", action="store_true", help="what was done as JSON on stdout")


def run(arguments: argparse.Namespace) -> int:
    """Mark each recording to be kept, or remove the mark."""
    from calm_edge.recording.retention import set_kept

    for drive in arguments.recording:
        set_kept(drive, not arguments.release)
        if not arguments.json:
            print(f"{'released' if arguments.release else 'kept':9}{drive}")
    if arguments.json:
        names = [str(drive) for drive in arguments.recording]
        print(json.dumps({"recordings": names, "kept": not arguments.release}, indent=1))
    return OK
