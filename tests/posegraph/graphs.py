"""Joint graphs of simulated sub-maps, and true and false loop closures to add to them."""

from __future__ import annotations

import numpy as np

from calm_edge.config import PoseGraphConfig
from calm_edge.geometry import se3
from calm_edge.posegraph.joint_graph import JointGraph
from calm_edge.posegraph.optimiser import Solved
from calm_edge.posegraph.optimum import TOLERANCE, optimum
from calm_edge.types import LoopClosure
from tests.drives import T_P_A

CONFIG = PoseGraphConfig()
# Drift per keyframe, the same in all sub-maps: 5 % of the distance and 0.6 degrees of yaw.
SEVERE = np.array([0, 0.002, 0.05, 0, 0.01, 0])
N_LAP = 120


def graph_of(
    T,
    *,
    noise=0.0,
    turn=0.1,
    bias=None,
    rectified=False,
    seed=0,
    n_max=15,
    spacing=1.0,
    config=CONFIG,
):
    """Graph of sub-maps of `n_max` keyframes that overlap by 3, with independent noise.

    noise: sigma of a view's position; turn: sigma of its rotation over that, rad per unit.
    rectified: scale each sub-map to the true camera spacing, as in IV-B.
    """
    rng = np.random.default_rng(seed)
    graph = JointGraph(config, spacing)
    for start in range(0, len(T) - 3, n_max - 3):
        ids = tuple(range(start, min(start + n_max, len(T))))
        sigma = np.repeat([noise, noise * turn], 3)
        T_s_p = T[list(ids)] @ se3.exp(rng.normal(size=(len(ids), 6)) * sigma)
        T_s_a = T[list(ids)] @ T_P_A @ se3.exp(rng.normal(size=(len(ids), 6)) * sigma)
        if bias is not None:
            drift = se3.exp(np.arange(len(ids))[:, None] * bias)
            T_s_p, T_s_a = drift @ T_s_p, drift @ T_s_a
        T_s = se3.inverse(T_s_p[0])
        T_s_p, T_s_a = T_s @ T_s_p, T_s @ T_s_a
        if rectified:
            seen = np.linalg.norm((T_s_a - T_s_p)[:, :3, 3], axis=-1).mean()
            T_s_p[:, :3, 3] *= np.linalg.norm(T_P_A[:3, 3]) / seen
            T_s_a[:, :3, 3] *= np.linalg.norm(T_P_A[:3, 3]) / seen
        if not len(graph):
            graph.set_rig_prior(se3.mean(se3.inverse(T_s_p) @ T_s_a))
        T_w_s = graph.pose(start) if start in graph else T[0]
        graph.add_submap(ids, T_w_s, T_s_p, T_s_a, np.arange(len(ids)))
    return graph


def optimised(graph, tolerance=TOLERANCE):
    """Moves a graph to its optimum, which is returned."""
    asked = graph.snapshot()
    found = optimum(asked.problem, asked.state, tolerance)
    assert graph.apply(Solved(asked.graph, found))
    return found


def true_loops(T, n, rng):
    """`n` true loops to the keyframe N_LAP earlier, measured to 2 cm and 0.1 degrees."""
    query = np.linspace(N_LAP, len(T) - 1, n).astype(int)
    error = se3.exp(rng.normal(size=(n, 6)) * np.repeat([0.02, 0.002], 3))
    return [
        LoopClosure(int(i), int(i - N_LAP), se3.inverse(T[i - N_LAP]) @ T[i] @ e)
        for i, e in zip(query, error, strict=True)
    ]


def false_loops(T, n, rng):
    """`n` false loops: places at least a tenth of a lap apart, taken for the same place."""
    loops: list[LoopClosure] = []
    while len(loops) < n:
        j, i = sorted(rng.integers(0, len(T), 2).tolist())
        if i - j >= 30 and min((i - j) % N_LAP, (j - i) % N_LAP) >= N_LAP // 10:
            error = rng.normal(size=6) * np.repeat([0.5, 0.1], 3)
            loops.append(LoopClosure(i, j, se3.exp(error)))
    return loops
