"""`python -m bench NAME`: one door to everything that is measured. Never shipped."""

from __future__ import annotations

import sys
from importlib import import_module

COMMANDS = {
    "targets": ("bench.targets", "the promises of `record` and `map`, run as a user would"),
    "kilometres": ("bench.kilometres.__main__", "kilometres by the scripted backbone"),
    "kilometres.tables": ("bench.kilometres.tables", "the paper's tables over these drives"),
    "pixels": ("bench.pixels", "pictures: ours, both baselines, ORB-SLAM3, COLMAP"),
    "mapping": ("bench.mapping.__main__", "map accuracy, completeness, chamfer, seams"),
    "model": ("bench.model.__main__", "correspondences of the learned model and classical ones"),
    "model.depth": ("bench.model.depth", "depth of the learned model and classical ones"),
    "model.place_table": ("bench.model.place_table", "place recognition"),
    "model.real_clips": ("bench.model.real_clips", "matches on real clips"),
    "model.pipeline": ("bench.model.pipeline", "whole drives with and without the network"),
    "cost": ("bench.cost.__main__", "what each stage costs; long drives"),
    "cost.load": ("bench.cost.load", "live poses and ticks on a busy machine"),
    "cost.mapping": ("bench.cost.mapping", "processor time of anchors and mapping, by stage"),
    "datasets": ("bench.datasets.command", "KITTI odometry, KITTI-360, Argoverse as published"),
    "tables": ("bench.tables", "report.html and report.json of the kept tables"),
}


def main(argv: list[str] | None = None) -> int:
    """Run one command with the rest of the arguments; 2 where there is none of that name."""
    name, *rest = (sys.argv[1:] if argv is None else argv) or ["--help"]
    if name in ("-h", "--help"):
        print("usage: python -m bench NAME [ARGUMENTS]\n")
        print("\n".join(f"  {key:18} {text}" for key, (_, text) in COMMANDS.items()))
        return 0
    if name not in COMMANDS:
        print(f"bench: {name!r} is unknown; known: {', '.join(COMMANDS)}", file=sys.stderr)
        return 2
    return int(import_module(COMMANDS[name][0]).main(rest))


if __name__ == "__main__":
    sys.exit(main())
