"""Joint graphs of scripted sub-maps, and loops true and false to plant in them."""

from __future__ import annotations

import numpy as np

from calm_edge.config import PoseGraphConfig
from calm_edge.geometry import se3
from calm_edge.posegraph.joint_graph import JointGraph
from calm_edge.types import LoopClosure
from tests.drives import T_P_A

CONFIG = PoseGraphConfig()
# A drift that every sub-map has alike: 5 % of the way and 0.6 degrees of yaw a step.
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
    """Sub-maps of `n_max` frames, 3 shared, each seen through its own noise.

    noise: of a view's position; turn: of its rotation, radians a unit of noise. rectified: each
    sub-map is scaled to the true spacing by its own, as IV-B does.
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


def true_loops(T, n, rng):
    """`n` returns, a lap of N_LAP poses later, measured to 2 cm and 0.1 degrees."""
    query = np.linspace(N_LAP, len(T) - 1, n).astype(int)
    error = se3.exp(rng.normal(size=(n, 6)) * np.repeat([0.02, 0.002], 3))
    return [
        LoopClosure(int(i), int(i - N_LAP), se3.inverse(T[i - N_LAP]) @ T[i] @ e)
        for i, e in zip(query, error, strict=True)
    ]


def false_loops(T, n, rng):
    """`n` places a tenth of a lap apart or more, each taken for the other by its looks."""
    loops: list[LoopClosure] = []
    while len(loops) < n:
        j, i = sorted(rng.integers(0, len(T), 2).tolist())
        if i - j >= 30 and min((i - j) % N_LAP, (j - i) % N_LAP) >= N_LAP // 10:
            error = rng.normal(size=6) * np.repeat([0.5, 0.1], 3)
            loops.append(LoopClosure(i, j, se3.exp(error)))
    return loops
