"""Errors of calm-edge and baselines on drives of kilometres with scripted predictions.

A row for each variant and seed. With `--lens` both cameras are behind a lens: the model of `ours`
gets the pictures as they are, that of `calibrated` undistorted ones, and section V works on the
pixels of either. focal %: error of both focal lengths at the end, rms, against those of the lens.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from bench.kilometres import runs
from bench.kilometres.dials import sized
from bench.kilometres.drives import SEQUENCES, Drive, kitti, rendered
from bench.kilometres.lenses import LENSES
from bench.kilometres.loops import ScriptedLoops
from bench.kilometres.predictions import cached
from bench.kilometres.rivals import HeldViews, rival
from bench.kilometres.runs import Outcome, Variant
from bench.kilometres.streams import Streams
from bench.tables import print_rows
from calm_edge.config import Config, load
from calm_edge.types import CalmEdgeError

_HELD = HeldViews()
VARIANTS = {
    "ours": Variant("ours"),
    "calibrated": Variant("calibrated", calibrated=True),
    "uncorrected": Variant("uncorrected", {"correction": {"apply": "never"}}),
    "sim3": rival("sim3", _HELD),
    "sl4": rival("sl4", _HELD),
}
_COLUMNS = (
    "variant",
    "seq",
    "seed",
    "m",
    "sub-maps",
    "Sim(3) m",
    "SE(3) m",
    "%",
    "focal %",
    "ms a sub-map",
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command to `parser`."""
    parser.add_argument(
        "--sequences", default=",".join(SEQUENCES), help="00,05,... or folders of rendered drives"
    )
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--variants", default="ours", help=", ".join(VARIANTS))
    parser.add_argument("--alternate", action="store_true", help="the paper's asynchronous mode")
    parser.add_argument("--loops", action="store_true", help="with a scripted loop finder")
    parser.add_argument("--frames", type=int, default=0, help="only the first frames; 0 for all")
    parser.add_argument("--lens", choices=list(LENSES), default="", help="default: none")
    parser.add_argument("--set", dest="assignments", action="append", default=[])


def run(options: argparse.Namespace) -> int:
    """Print a row for each variant, drive and seed, then the means."""
    rows: list[tuple[str, str, int, Outcome]] = []
    config = load(None, options.assignments)
    variants = [_variant(name) for name in options.variants.split(",")]
    for name in options.sequences.split(","):
        for seed in range(options.seeds):
            streams = Streams(alternate=options.alternate)
            drive = _drive(name, config, seed, streams, options)
            for variant in variants:
                outcome = _outcome(drive, seed, variant, config, options.loops)
                rows.append((variant.name, name, seed, outcome))
                print(variant.name, name, seed, *_figures(outcome), file=sys.stderr)
    table = [[variant, name, seed, *_figures(outcome)] for variant, name, seed, outcome in rows]
    for variant in variants:
        figures = [_figures(outcome) for of, _, _, outcome in rows if of == variant.name]
        table.append([variant.name, "mean", None, *np.mean(figures, axis=0).tolist()])
    print_rows(_COLUMNS, table)
    return 0


def _drive(
    name: str, config: Config, seed: int, streams: Streams, options: argparse.Namespace
) -> Drive:
    if Path(name).is_dir():
        return rendered(Path(name), config, seed, streams)
    return kitti(name, config, seed, streams, options.frames, options.lens)


def _variant(name: str) -> Variant:
    if name not in VARIANTS:
        raise CalmEdgeError(f"--variants {name}: unknown; known: {', '.join(VARIANTS)}")
    return VARIANTS[name]


def _outcome(
    drive: Drive, seed: int, variant: Variant, config: Config, with_loops: bool
) -> Outcome:
    loops = ScriptedLoops(drive, config.loops.min_gap, seed=seed) if with_loops else None
    return runs.run(drive, cached(drive, sized(seed)), variant, config, loops)


def _figures(outcome: Outcome) -> list[float]:
    return [
        outcome.path_m,
        outcome.n_submaps,
        outcome.ate_sim3_m,
        outcome.ate_se3_m,
        outcome.percent,
        outcome.focal_percent,
        outcome.ms,
    ]
