"""`calm-edge recover`: a whole recording out of a damaged one."""

from __future__ import annotations

import argparse
from pathlib import Path


def configure(parser: argparse.ArgumentParser) -> None:
    """Its arguments."""
    parser.add_argument("recording", type=Path, help="a recording folder or an MCAP file")
    parser.add_argument(
        "--out", type=Path, help="a new folder, or a new file; by default beside the recording"
    )


def run(arguments: argparse.Namespace) -> int:
    """Copies what can be read; its exit code says whether something was lost."""
    from calm_edge.commands.validate import tell
    from calm_edge.recording.recovery import default_target, recover

    source: Path = arguments.recording
    return tell(recover(source, arguments.out or default_target(source)))
