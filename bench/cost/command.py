"""Time and memory of calm-edge on this machine, beside the paper's figures and the required ones.

The tables mark requirements that are not met. The exit code is 1 only if nothing could be measured.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2

from bench.cost import joint_optimum, length, stages
from bench.tables import OUT, publish

PLOT = Path("build") / "bench" / "length.svg"


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command to `parser`."""
    parser.add_argument("recording", type=Path, nargs="?", help="none: only the long drive")
    parser.add_argument("--submaps", type=int, default=2000, help="of the long drive; 0 for none")
    parser.add_argument("--out", type=Path, default=OUT)
    parser.add_argument("--plot", type=Path, default=PLOT)


def run(options: argparse.Namespace) -> int:
    """Measure, print and save the tables and the plot; return the exit code."""
    cv2.setNumThreads(1)
    # the long drive comes first, since memory of other measurements would add to its own
    if options.submaps:
        course = length.drive(options.submaps)
        publish(length.table(course, options.command), options.out)
        options.plot.parent.mkdir(parents=True, exist_ok=True)
        options.plot.write_text(length.plot(course), encoding="utf-8")
        print(f"  plot: {options.plot}")
        runs = joint_optimum.optimisations(course)
        peak = joint_optimum.peak_bytes(course)
        publish(
            joint_optimum.table(runs, options.command, float(course.rss[-1]), peak), options.out
        )
    if options.recording is not None:
        publish(stages.table(stages.measure(options.recording), options.command), options.out)
    return 0
