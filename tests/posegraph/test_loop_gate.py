import numpy as np
import pytest

from calm_edge.evaluation.trajectory import ate
from calm_edge.geometry import se3
from calm_edge.geometry.similarity import align
from calm_edge.posegraph.loop_gate import accepted_loops
from calm_edge.posegraph.noise import measured_noise
from calm_edge.types import LoopClosure
from tests.drives import circle
from tests.posegraph.graphs import N_LAP, SEVERE, false_loops, graph_of, optimised, true_loops

DRIFTS = {
    "mild": {"noise": 0.01, "bias": SEVERE / 5},
    "severe": {"noise": 0.003, "bias": SEVERE},
    "white": {"noise": 0.05},
}


def laps():
    """Poses of a lap around a circle and two fifths of the next."""
    lap = circle(N_LAP)
    return np.concatenate([lap, lap @ se3.inverse(lap[0])])[: N_LAP + 50]


def error_after(drift, seed, loops):
    """ATE of the optimised graph with these loops."""
    T = laps()
    graph = graph_of(T, seed=seed, **DRIFTS[drift])
    for loop in loops:
        graph.add_loop(loop)
    optimised(graph)
    p = graph.poses()[:, :3, 3]
    return ate(align(p, T[:, :3, 3], with_scale=False).points(p), T[:, :3, 3])


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("drift", DRIFTS)
def test_false_loops_alone_leave_the_path_as_it_was(drift, seed):
    rng = np.random.default_rng(seed)
    loops = false_loops(laps(), 8, rng)
    without = error_after(drift, seed, [])
    assert error_after(drift, seed, loops) <= 1.05 * without
    assert error_after(drift, seed, loops[:1]) <= 1.05 * without


@pytest.mark.parametrize(("n_true", "n_false"), [(9, 1), (8, 8)])
@pytest.mark.parametrize("drift", DRIFTS)
def test_true_loops_close_in_spite_of_false_ones(drift, n_true, n_false):
    rng, T = np.random.default_rng(11), laps()
    loops = true_loops(T, n_true, rng)
    mixed = [*loops, *false_loops(T, n_false, rng)]
    mixed = [mixed[k] for k in rng.permutation(len(mixed))]
    without = error_after(drift, 0, [])
    closed = error_after(drift, 0, loops)
    assert closed < 0.6 * without
    assert error_after(drift, 0, mixed) <= 1.1 * closed


def accepted(loops, drift="mild"):
    T = laps()
    graph = graph_of(T, **DRIFTS[drift])
    for loop in loops:
        graph.add_loop(loop)
    problem = graph.problem()
    return accepted_loops(problem, graph.poses(), measured_noise(problem)).tolist()


def test_a_single_loop_within_typical_drift_is_accepted():
    T = laps()
    assert accepted([LoopClosure(40, 5, se3.inverse(T[5]) @ T[40])]) == [True]


def test_of_two_contradicting_loops_the_likelier_is_accepted():
    T = laps()
    aside = se3.exp(np.array([2.0, 0, 0, 0, 0, 0]))
    true = LoopClosure(70, 5, se3.inverse(T[5]) @ T[70])
    off = LoopClosure(71, 5, se3.inverse(T[5]) @ T[71] @ aside)
    assert accepted([true], "white") == accepted([off], "white") == [True]
    assert accepted([off, true], "white") == [False, True]


def test_severe_drift_needs_three_agreeing_loops():
    T = laps()
    loops = [LoopClosure(N_LAP + k, k, se3.inverse(T[k]) @ T[N_LAP + k]) for k in (0, 12, 24)]
    assert accepted(loops, "severe") == [True, True, True]
    assert accepted(loops[:2], "severe") == [False, False]
    spoiled = LoopClosure(N_LAP + 24, 24, se3.exp(np.array([0, 0, 9.0, 0, 2.0, 0])))
    assert accepted([*loops[:2], spoiled], "severe") == [False, False, False]


def test_without_loops_the_result_is_empty():
    assert accepted([]) == []
