"""`python -m calm_edge.evaluation.kilometres`: the Localizer over scripted kilometres."""

from __future__ import annotations

import argparse
import sys

import numpy as np

from calm_edge.config import Config, load
from calm_edge.evaluation.kilometres.dials import sized
from calm_edge.evaluation.kilometres.drives import SEQUENCES, kitti
from calm_edge.evaluation.kilometres.predictions import cached
from calm_edge.evaluation.kilometres.runs import Variant, run
from calm_edge.evaluation.kilometres.streams import Streams
from calm_edge.evaluation.table import print_rows
from calm_edge.types import CalmEdgeError

_COLUMNS = ("seq", "seed", "m", "sub-maps", "Sim(3) m", "SE(3) m", "% of path", "ms a sub-map")


def main(arguments: list[str] | None = None) -> int:
    """Prints a row a sequence and seed; 0, or 1 with one line where a drive is not here."""
    parser = argparse.ArgumentParser(prog="python -m calm_edge.evaluation.kilometres")
    parser.add_argument("--sequences", default=",".join(SEQUENCES), help="00,05,...")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--alternate", action="store_true", help="odd and even frames an eye")
    parser.add_argument("--frames", type=int, default=0, help="only the first so many; 0 all")
    parser.add_argument("--set", dest="assignments", action="append", default=[])
    asked = parser.parse_args(arguments)
    rows: list[list[object]] = []
    try:
        config = load(None, asked.assignments)
        for name in asked.sequences.split(","):
            for seed in range(asked.seeds):
                rows.append(_row(name, seed, config, asked))
                print(*rows[-1], file=sys.stderr)
    except CalmEdgeError as error:
        print(error, file=sys.stderr)
        return 1
    mean = np.mean([[row[4], row[5], row[6], row[7]] for row in rows], axis=0)  # type: ignore[arg-type]
    rows.append(["mean", None, None, None, *mean.tolist()])
    print_rows(_COLUMNS, rows)
    return 0


def _row(name: str, seed: int, config: Config, asked: argparse.Namespace) -> list[object]:
    streams = Streams(alternate=asked.alternate)
    drive = kitti(name, config, seed, streams, asked.frames)
    outcome = run(drive, cached(drive, sized(seed)), Variant("ours"), config)
    return [
        name,
        seed,
        outcome.path_m,
        outcome.n_submaps,
        outcome.ate_sim3_m,
        outcome.ate_se3_m,
        outcome.percent,
        outcome.ms,
    ]


if __name__ == "__main__":
    sys.exit(main())
