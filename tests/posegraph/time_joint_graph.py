"""Measure time and memory of the joint graph at the length of KITTI 00.

`python -m tests.posegraph.time_joint_graph`.
"""

from __future__ import annotations

import tracemalloc
from time import perf_counter, process_time

import numpy as np

from calm_edge.geometry import se3
from calm_edge.posegraph.joint_graph import JointGraph
from calm_edge.posegraph.marginals import Marginals
from calm_edge.posegraph.noise import measured_noise
from calm_edge.types import LoopClosure
from tests.drives import T_P_A, curved, position_error
from tests.posegraph.graphs import CONFIG, graph_of

N = 4541
N_SUBMAPS = 2000


def optimising() -> JointGraph:
    """Time the optimisation without loops, with one, and with 30 true and 10 false ones.

    Returns the last graph.
    """
    T = curved(N)
    last = LoopClosure(N - 1, 0, se3.inverse(T[0]) @ T[-1])
    query = np.linspace(N // 2, N - 2, 30).astype(int)
    many = [LoopClosure(int(i), int(N - i), se3.inverse(T[N - i]) @ T[i]) for i in query]
    many += [LoopClosure(int(i), int(i // 3), np.eye(4)) for i in query[1::3]]
    for name, loops in (("no loop", []), ("one loop", [last]), ("40 loops", many)):
        graph = graph_of(T, noise=0.01)
        for loop in loops:
            graph.add_loop(loop)
        before = position_error(graph.poses(), T)
        wall, cpu = perf_counter(), process_time()
        outcome = graph.optimise()
        wall, cpu = perf_counter() - wall, process_time() - cpu
        after = position_error(graph.poses(), T)
        print(
            f"{name}: {N} keyframes, {len(graph.problem().edges.i)} pairs, "
            f"{outcome.iterations} iterations, {wall:.2f} s ({cpu:.2f} s CPU, "
            f"{cpu / N * 1e3:.2f} ms per keyframe), {outcome.loops.sum()} loops accepted, "
            f"mean error {np.mean(before):.2f} -> {np.mean(after):.2f}"
        )
    return graph


def covariances(graph: JointGraph) -> None:
    problem = graph.problem()
    start = process_time()
    marginals = Marginals(problem, graph.state(), measured_noise(problem))
    factorised = process_time()
    marginals.covariances(np.array([N // 2, N - 1]))
    print(
        f"covariances: {factorised - start:.2f} s to factorise, "
        f"{(process_time() - factorised) / 2 * 1e3:.0f} ms a keyframe; ",
        end="",
    )
    start = process_time()
    graph.relative_covariance(N - 1, N - 11)
    print(f"of the newest against one 10 before: {(process_time() - start) * 1e3:.1f} ms (CPU)")


def growing() -> None:
    """Time `add_submap` for the first and the last 200 sub-maps; memory per keyframe."""
    T = curved(15)
    T_s_p, T_s_a = T, T @ T_P_A
    graph = JointGraph(CONFIG)
    graph.set_rig_prior(T_P_A)
    spent = []
    tracemalloc.start()
    for k in range(N_SUBMAPS):
        ids = tuple(range(12 * k, 12 * k + 15))
        T_w_s = graph.pose(ids[0]) if ids[0] in graph else np.eye(4)
        start = process_time()
        graph.add_submap(ids, T_w_s, T_s_p, T_s_a, np.arange(15))
        spent.append(process_time() - start)
    held = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    first, last = np.median(spent[:200]) * 1e6, np.median(spent[-200:]) * 1e6
    start = process_time()
    graph.snapshot()
    print(
        f"add_submap: {first:.0f} us at first, {last:.0f} us after {N_SUBMAPS} sub-maps "
        f"(allocations traced); {held / len(graph):.0f} bytes a keyframe; "
        f"a snapshot of {len(graph)} keyframes {(process_time() - start) * 1e3:.0f} ms"
    )


def main() -> None:
    covariances(optimising())
    growing()


if __name__ == "__main__":
    main()
