import dataclasses

import numpy as np
import pytest

from calm_edge.posegraph import linear_system
from calm_edge.posegraph.linear_system import Layout, LinearSystem, linearise
from calm_edge.posegraph.problem import State, huber, residuals, robust_weights
from calm_edge.types import LoopClosure
from tests.drives import curved
from tests.posegraph.graphs import CONFIG, graph_of


def dense_steps(problem, state, damping):
    """Solution of the same normal equations as one dense matrix."""
    edges, n = problem.edges, len(state.T_w_p)
    r = residuals(problem, state)
    rows = linearise(problem, state, r, robust_weights(problem, r, huber), np.arange(len(edges.i)))
    A = np.zeros((len(edges.i), 12, n + 1, 6))
    pairs = np.arange(len(edges.i))
    A[pairs, :, edges.i], A[pairs, :, edges.j], A[:, :, n] = rows.by_i, rows.by_j, rows.by_rig
    A = A.reshape(-1, 6 * n + 6)
    H, g = A.T @ A, A.T @ rows.b.ravel()
    # T_p_a equals its prior: residual zero, Jacobian identity
    H[-6:, -6:] += np.diag(problem.sigma_prior**-2)
    H[:6, :6] += np.diag(problem.sigma**-2)
    return np.linalg.solve(H + damping * np.eye(len(H)), g).reshape(-1, 6)


@pytest.mark.parametrize("n", [4, 5, 40])
@pytest.mark.parametrize("window", [1, 3, 9])
@pytest.mark.parametrize("damping", [1e-11, 3.0])
def test_steps_are_those_of_the_dense_normal_equations(n, window, damping):
    config = dataclasses.replace(CONFIG, window=window)
    graph = graph_of(curved(n), noise=0.1, config=config)
    if n == 40:
        for query, match in ((39, 0), (38, 1), (20, 3), (3, 0)):
            graph.add_loop(LoopClosure(query, match, np.eye(4)))
        graph.add_bridge(12, 13)
    problem, state = graph.problem(), graph.state()
    r = residuals(problem, state)
    layout = Layout(problem.edges, len(state.T_w_p))
    steps = LinearSystem(problem, state, r, huber, layout).solve(damping)
    expected = dense_steps(problem, state, damping)
    assert steps.shape == expected.shape
    assert np.abs(steps - expected).max() < 1e-7 * max(1.0, np.abs(expected).max())


@pytest.mark.parametrize("window", [1, 3])
def test_steps_are_the_same_with_elimination_chunk_by_chunk(monkeypatch, window):
    graph = graph_of(curved(60), noise=0.1, config=dataclasses.replace(CONFIG, window=window))
    for query, match in ((59, 0), (58, 1), (33, 12)):
        graph.add_loop(LoopClosure(query, match, np.eye(4)))
    problem, state = graph.problem(), graph.state()
    r = residuals(problem, state)
    monkeypatch.setattr(linear_system, "_CHUNK", 8)
    layout = Layout(problem.edges, len(state.T_w_p))
    assert len(list(layout.chunks())) > 5
    assert layout.looped.tolist().count(True) == 4
    steps = LinearSystem(problem, state, r, huber, layout).solve(1e-11)
    expected = dense_steps(problem, state, 1e-11)
    assert np.abs(steps - expected).max() < 1e-7 * max(1.0, np.abs(expected).max())


def test_the_smallest_graph_is_two_keyframes():
    graph = graph_of(curved(5), noise=0.1)
    problem = graph.problem()
    only = problem.edges.chosen((problem.edges.i == 1) & (problem.edges.j == 0))
    problem = dataclasses.replace(problem, edges=only)
    state = State(graph.poses()[:2], graph.T_p_a)
    r = residuals(problem, state)
    steps = LinearSystem(problem, state, r, huber, Layout(only, 2)).solve(1e-11)
    assert np.abs(steps - dense_steps(problem, state, 1e-11)).max() < 1e-7
