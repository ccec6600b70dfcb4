"""`python -m tests.posegraph.time_joint_graph`: the cost of optimising KITTI 00's length."""

from __future__ import annotations

from time import perf_counter, process_time

import numpy as np

from calm_edge.geometry import se3
from calm_edge.types import LoopClosure
from tests.drives import curved, position_error
from tests.posegraph.test_joint_graph import graph_of

N = 4541


def main() -> None:
    T = curved(N)
    loop = LoopClosure(N - 1, 0, se3.inverse(T[0]) @ T[-1])
    for name, loops in (("no loop", []), ("one loop", [loop])):
        graph = graph_of(T, noise=0.01)
        for closure in loops:
            graph.add_loop(closure)
        before = position_error(graph.poses(), T)
        wall, cpu = perf_counter(), process_time()
        outcome = graph.optimise()
        wall, cpu = perf_counter() - wall, process_time() - cpu
        after = position_error(graph.poses(), T)
        print(
            f"{name}: {N} keyframes, {len(graph.problem().edges.i)} pairs, "
            f"{outcome.iterations} iterations, {wall:.2f} s ({cpu:.2f} s CPU), "
            f"mean error {np.mean(before):.2f} -> {np.mean(after):.2f}"
        )


if __name__ == "__main__":
    main()
