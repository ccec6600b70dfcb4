import numpy as np

from calm_edge.posegraph import levenberg_marquardt
from calm_edge.posegraph.levenberg_marquardt import minimise
from calm_edge.posegraph.linear_system import LinearSystem
from calm_edge.posegraph.problem import cauchy
from tests.drives import curved
from tests.posegraph.graphs import graph_of


def test_damping_rises_until_the_system_is_positive_definite(monkeypatch):
    graph = graph_of(curved(40), noise=0.02)
    expected = minimise(graph.problem(), graph.state(), cauchy, 1e-9)
    solve, asked = LinearSystem.solve, []

    def rounded(self, damping):
        asked.append(damping)
        return None if damping < 1e-8 else solve(self, damping)

    monkeypatch.setattr(LinearSystem, "solve", rounded)
    found = minimise(graph.problem(), graph.state(), cauchy, 1e-9)
    assert np.allclose(found.T_w_p, expected.T_w_p, atol=1e-3)
    # the raised lower bound of the damping persists over iterations
    assert sum(damping < 1e-8 for damping in asked) <= 4


def test_the_state_stays_if_the_system_cannot_be_solved(monkeypatch):
    graph = graph_of(curved(20), noise=0.02)
    monkeypatch.setattr(LinearSystem, "solve", lambda self, damping: None)
    monkeypatch.setattr(levenberg_marquardt, "_MAX_DAMPING", 1e-6)
    found = minimise(graph.problem(), graph.state(), cauchy, 1e-9)
    assert np.array_equal(found.T_w_p, graph.state().T_w_p)
