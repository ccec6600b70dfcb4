"""`calm-edge validate`: is a recording whole?"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from calm_edge.recording.recovery import RecordingReport


def configure(parser: argparse.ArgumentParser) -> None:
    """Its arguments."""
    parser.add_argument("recording", type=Path, help="a recording folder or an MCAP file")


def run(arguments: argparse.Namespace) -> int:
    """Reads every byte; its exit code says whether something is lost."""
    from calm_edge.recording.recovery import validate

    return tell(validate(arguments.recording))


def tell(report: RecordingReport) -> int:
    """Counts to stdout, losses to stderr; returns the exit code."""
    for file in report.files:
        print(file)
    for topic, count in sorted(report.messages.items()):
        print(f"{topic:20} {count}")
    for line in report.losses:
        print(f"calm-edge: {line}", file=sys.stderr)
    return int(report.outcome)
