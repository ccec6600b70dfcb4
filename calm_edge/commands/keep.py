"""`calm-edge keep`: a drive that must not make room for newer ones."""

from __future__ import annotations

import argparse
from pathlib import Path

from calm_edge.commands.exit_codes import OK


def configure(parser: argparse.ArgumentParser) -> None:
    """Its arguments."""
    parser.add_argument("recording", type=Path, nargs="+", help="a recording folder")
    parser.add_argument(
        "--release", action="store_true", help="it may be removed again, as it may from the start"
    )


def run(arguments: argparse.Namespace) -> int:
    """Sets or takes away the flag of each."""
    from calm_edge.recording.retention import set_kept

    for drive in arguments.recording:
        set_kept(drive, not arguments.release)
        print(f"{'released' if arguments.release else 'kept':9}{drive}")
    return OK
