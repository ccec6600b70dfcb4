"""Command line of the benchmarks: `python -m bench NAME`. Not part of the shipped package.

A command is a module with `configure(parser)`, which adds the arguments, and `run(options)`, which
returns the exit code; the module's docstring is the text of `--help`.
"""

from __future__ import annotations

import argparse
import shlex
import sys
from importlib import import_module

from calm_edge.commands.exit_codes import ERROR
from calm_edge.types import CalmEdgeError

COMMANDS = {
    "targets": ("bench.targets", "accuracy of `record` and `map` on whole drives"),
    "kilometres": ("bench.kilometres.variants", "variants and baselines on scripted kilometres"),
    "kilometres.tables": ("bench.kilometres.tables", "the paper's tables on scripted kilometres"),
    "pixels": ("bench.pixels", "pictures: ours, both baselines, ORB-SLAM3 and COLMAP"),
    "mapping": ("bench.mapping.quality", "map accuracy, completeness, chamfer distance and seams"),
    "model.matches": ("bench.model.match_table", "correspondences, learned and classical"),
    "model.depth": ("bench.model.depth", "depth, learned and classical"),
    "model.places": ("bench.model.place_table", "place recognition, learned and classical"),
    "model.clips": ("bench.model.real_clips", "correspondences on real clips"),
    "model.pipeline": ("bench.model.pipeline", "whole drives with and without the network"),
    "cost": ("bench.cost.command", "time and memory of each stage, and over a long drive"),
    "cost.load": ("bench.cost.load", "frame loss and pose age on a busy machine"),
    "cost.start": ("bench.cost.start", "time until --help and --version answer"),
    "cost.pipes": ("bench.cost.pipes", "bytes between the processes of `record`"),
    "cost.mapping": ("bench.cost.mapping", "processor time of anchors and mapping by stage"),
    "cost.clouds": ("bench.cost.clouds", "memory and time of exported clouds, by their points"),
    "cost.search": ("bench.cost.focal_search", "focal errors of the intrinsic search over sigma"),
    "consistency": ("bench.consistency", "pose errors of the joint graph over their covariances"),
    "lottery": ("bench.lottery.command", "drives drawn by lot: steps, scale, focal and sigmas"),
    "honesty": ("bench.honesty", "errors over the sigmas claimed for them"),
    "spoilt": ("bench.spoilt.command", "drives that mislead: the right metre, or none"),
    "accuracy": ("bench.accuracy.command", "four conditions on three tracks, and real clips"),
    "windows": ("bench.windows", "errors of single windows over their sigmas: scale and poses"),
    "datasets": ("bench.datasets.command", "KITTI odometry, KITTI-360 and Argoverse as published"),
    "imported": ("bench.imported", "two videos of a drive: clock offset, trajectory error"),
    "joined": ("bench.joined", "two drives in one map: joined or apart, error in one frame"),
    "gps": ("bench.gps", "simulated GPS fixes: delay, refused fixes, scale, path error"),
    "tables": ("bench.tables", "report.html and report.json of all tables kept so far"),
}


def main(argv: list[str] | None = None) -> int:
    """Run the command named in `argv` and return its exit code.

    A CalmEdgeError is printed as one line without a traceback; the exit code is then ERROR.
    """
    name, *rest = (sys.argv[1:] if argv is None else argv) or ["--help"]
    if name in ("-h", "--help"):
        print("usage: python -m bench NAME [ARGUMENTS]; NAME --help lists the arguments\n")
        print("\n".join(f"  {key:18} {text}" for key, (_, text) in COMMANDS.items()))
        return 0
    if name not in COMMANDS:
        print(f"bench: no command {name!r}; there are: {', '.join(COMMANDS)}", file=sys.stderr)
        return 2
    module = import_module(COMMANDS[name][0])
    parser = argparse.ArgumentParser(
        prog=f"python -m bench {name}",
        description=module.__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    module.configure(parser)
    options = parser.parse_args(rest)
    options.command = shlex.join(["python", "-m", "bench", name, *rest])
    try:
        return int(module.run(options))
    except CalmEdgeError as error:
        print(f"bench: {' '.join(str(error).split())}", file=sys.stderr)
        return ERROR


if __name__ == "__main__":
    sys.exit(main())
