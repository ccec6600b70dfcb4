"""`python -m bench.cost RECORDING`: tables of what calm-edge costs here.

Figures of one run on one machine, beside the paper's and the promised ones. A promise that is not
kept is said in its table; the exit code is 1 only where nothing could be measured.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import cv2

from bench.cost import joint_optimum, length, stages
from bench.tables import OUT, publish
from calm_edge.types import CalmEdgeError

PLOT = Path("build") / "bench" / "length.svg"


def main(argv: list[str] | None = None) -> int:
    """Measures, prints and keeps the tables and the plot."""
    parser = argparse.ArgumentParser(prog="bench.cost", description=__doc__)
    parser.add_argument("recording", type=Path, nargs="?", help="none: only the long drive")
    parser.add_argument("--submaps", type=int, default=2000, help="of the long drive; 0 for none")
    parser.add_argument("--out", type=Path, default=OUT)
    parser.add_argument("--plot", type=Path, default=PLOT)
    asked = parser.parse_args(argv)
    command = f"python -m {parser.prog} RECORDING --submaps {asked.submaps}"
    cv2.setNumThreads(1)
    try:
        # first: the memory of a process that has done little else
        if asked.submaps:
            course = length.drive(asked.submaps)
            publish(length.table(course, command), asked.out)
            asked.plot.parent.mkdir(parents=True, exist_ok=True)
            asked.plot.write_text(length.plot(course), encoding="utf-8")
            print(f"  plot: {asked.plot}")
            runs = joint_optimum.optimisations(course)
            peak = joint_optimum.peak_bytes(course)
            made = joint_optimum.table(runs, command, float(course.rss[-1]), peak)
            publish(made, asked.out)
        if asked.recording is not None:
            publish(stages.table(stages.measure(asked.recording), command), asked.out)
    except CalmEdgeError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
