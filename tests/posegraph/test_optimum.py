import numpy as np

from calm_edge.geometry import se3
from calm_edge.posegraph.optimum import optimum
from calm_edge.posegraph.problem import cauchy, cost, residuals
from calm_edge.types import LoopClosure
from tests.drives import circle, position_error
from tests.posegraph.graphs import SEVERE, graph_of


def test_the_optimum_costs_less_than_the_start():
    graph = graph_of(circle(60), noise=0.05)
    problem, start = graph.problem(), graph.state()
    found = optimum(problem, start)
    before, after = (cost(problem, residuals(problem, s), cauchy) for s in (start, found.state))
    assert after < before
    assert not len(found.loops)


def test_a_loop_beyond_typical_drift_is_accepted_once_the_lap_is_closed():
    T = circle(120)
    graph = graph_of(T, noise=0.003, bias=SEVERE)

    def loop(query, match):
        return LoopClosure(query, match, se3.inverse(T[match]) @ T[query])

    graph.add_loop(loop(60, 20))  # beyond typical drift, without support by loops nearby
    alone = optimum(graph.problem(), graph.state())
    assert alone.loops.tolist() == [False]
    for query, match in ((119, 0), (118, 1), (116, 2)):
        graph.add_loop(loop(query, match))
    found = optimum(graph.problem(), graph.state())
    assert found.loops.tolist() == [True] * 4
    assert position_error(found.state.T_w_p, T)[-1] < 0.2


def test_optimum_does_not_modify_its_input():
    graph = graph_of(circle(40), noise=0.05)
    start = graph.state()
    before = start.T_w_p.copy()
    optimum(graph.problem(), start)
    assert np.array_equal(start.T_w_p, before)
