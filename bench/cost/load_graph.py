"""`python -m bench.cost.load_graph KEYFRAMES`: optimises a long graph for ever.

What the optimiser's process does after a loop of a long drive, again and again; `ready` on stdout
once it has begun.
"""

from __future__ import annotations

import os
import sys

from bench.cost import joint_optimum, length
from calm_edge.config import Config
from calm_edge.posegraph.optimum import optimum

# the estimator's and the optimiser's own
NICE = 15


def main() -> None:
    frontend = Config().frontend
    new = frontend.n_max - frontend.n_overlap
    keyframes = int(sys.argv[1])
    asked = joint_optimum.snapshot(length.drive((keyframes - frontend.n_overlap + new - 1) // new))
    os.nice(NICE)
    print("ready", flush=True)
    while True:
        optimum(asked.problem, asked.state)


if __name__ == "__main__":
    main()
