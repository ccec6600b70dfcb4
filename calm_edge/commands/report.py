"""`calm-edge report`: write report.html of a recording."""

from __future__ import annotations

import argparse
from pathlib import Path

from calm_edge.commands.console import say
from calm_edge.commands.exit_codes import LOSS, OK


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("recording", type=Path, help="a recording folder or an MCAP file")
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="default: report.html in the recording"
    )
    parser.add_argument(
        "--truth", type=Path, metavar="FOLDER", help="show the error against this ground truth"
    )


def run(arguments: argparse.Namespace) -> int:
    """Write the page; return 3 if the recording is damaged or the truth is of another drive."""
    from calm_edge.recording.retention import REPORT_FILE
    from calm_edge.types import CalmEdgeError

    target: Path = arguments.recording
    if (target / "trajectory.tum").is_file():
        raise CalmEdgeError(
            f"{target}: is a map, whose report.html was written by `calm-edge map`; name the "
            "recording"
        )
    beside = target / REPORT_FILE if target.is_dir() else target.with_suffix(".report.html")
    out: Path = arguments.out or beside
    losses = write_report(target, out, arguments.truth)
    print(f"report      {out}")
    for line in losses:
        say(f"loss: {line}")
    return LOSS if losses else OK


def write_report(target: Path, out: Path, truth_folder: Path | None = None) -> list[str]:
    """Write the page of a recording; return a line for each part that is missing.

    Raises CalmEdgeError.
    """
    from calm_edge.evaluation.truth import read_truth
    from calm_edge.recording.reader import Recording
    from calm_edge.report.recording_report import recording_report
    from calm_edge.report.report import write_report as write
    from calm_edge.types import CalmEdgeError

    truth = None if truth_folder is None else read_truth(truth_folder)
    recording = Recording(target)
    try:
        write(out, recording_report(recording, truth, out))
    except OSError as error:
        raise CalmEdgeError(f"{out}: cannot be written ({error.strerror})") from None
    return recording.losses
