"""Child process of `cost.load` that optimises a graph of KEYFRAMES again and again, as load.

Prints `ready` before the first optimisation.
"""

from __future__ import annotations

import os
import sys

from bench.cost import joint_optimum, length
from calm_edge.config import Config
from calm_edge.posegraph.optimum import optimum

# niceness of the estimator and the optimiser
NICE = 15


def main() -> None:
    frontend = Config().frontend
    new = frontend.n_max - frontend.n_overlap
    keyframes = int(sys.argv[1])
    request = joint_optimum.snapshot(
        length.drive((keyframes - frontend.n_overlap + new - 1) // new)
    )
    os.nice(NICE)
    print("ready", flush=True)
    while True:
        optimum(request.problem, request.state)


if __name__ == "__main__":
    main()
