"""`calm-edge calibration`: write what a drive has learned of the cameras, for other programs."""

from __future__ import annotations

import argparse
from pathlib import Path

from calm_edge.commands.console import say
from calm_edge.commands.exit_codes import LOSS, OK

# as of interchange/calibration/formats, which is not imported for `--help`
FORMATS = ("opencv", "ros", "kalibr", "colmap")


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("recording", type=Path, help="a recording folder or an MCAP file")
    parser.add_argument("--format", choices=FORMATS, required=True, help="whose file format")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="a new folder")


def run(arguments: argparse.Namespace) -> int:
    """Write the files and print the calibration with its sigmas."""
    from calm_edge.interchange.calibration import formats
    from calm_edge.offline.learned import learned
    from calm_edge.recording.reader import Recording

    recording = Recording(arguments.recording)
    calibration, notes = learned(recording)
    files = formats.write(arguments.format, arguments.out, calibration, notes)
    for note in notes:
        print(note)
    for path in files:
        print(f"written     {path}")
    for line in recording.losses:
        say(f"loss: {line}")
    return LOSS if recording.losses else OK
