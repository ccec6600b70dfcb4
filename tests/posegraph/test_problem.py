import numpy as np

from calm_edge.posegraph import problem as problem_module
from calm_edge.posegraph.problem import residuals
from tests.drives import curved
from tests.posegraph.graphs import graph_of


def test_residuals_do_not_depend_on_the_chunk_size(monkeypatch):
    graph = graph_of(curved(40), noise=0.1)
    problem, state = graph.problem(), graph.state()
    whole = residuals(problem, state)
    assert np.abs(whole.primary).max() > 0.01
    monkeypatch.setattr(problem_module, "_CHUNK", 7)
    for few, all_at_once in zip(residuals(problem, state), whole, strict=True):
        assert np.array_equal(few, all_at_once)
