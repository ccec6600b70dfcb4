import dataclasses
import subprocess
import sys

import gtsam
import numpy as np
import pytest

from calm_edge.geometry import se3
from calm_edge.posegraph.joint_graph import JointGraph
from calm_edge.posegraph.optimiser import Solved
from calm_edge.posegraph.optimum import optimum
from calm_edge.posegraph.problem import cauchy, cost, residuals
from calm_edge.types import LoopClosure
from tests.drives import T_P_A, circle, curved, position_error
from tests.posegraph.graphs import CONFIG, SEVERE, graph_of, optimised


def reference_optimum(graph, sigma, sigma_prior):
    """Optimum by GTSAM's own optimiser, with IV-C as custom factors with numeric derivatives."""
    edges, n = graph.problem().edges, len(graph)

    def swapped(s):
        return gtsam.noiseModel.Diagonal.Sigmas(np.concatenate([s[3:], s[:3]]))

    def factor(model, keys, predicted):
        def error(_, values, H):
            poses = [values.atPose3(key) for key in keys]
            if H is not None:
                for k, pose in enumerate(poses):
                    columns = []
                    for axis in np.eye(6) * 1e-6:
                        ends = []
                        for d in (axis, -axis):
                            moved = [*poses]
                            moved[k] = pose.retract(d)
                            ends.append(gtsam.Pose3.Logmap(predicted(*moved)))
                        columns.append((ends[0] - ends[1]) / 2e-6)
                    H[k] = np.asfortranarray(np.stack(columns, 1))
            return gtsam.Pose3.Logmap(predicted(*poses))

        return gtsam.CustomFactor(model, keys, error)

    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for key, T in enumerate(graph.poses()):
        values.insert(key, gtsam.Pose3(T))
    values.insert(n, gtsam.Pose3(graph.T_p_a))
    prior = gtsam.Pose3(graph.problem().T_p_a_prior)
    factors.add(factor(swapped(sigma_prior), [n], lambda rig: prior.between(rig)))
    first = values.atPose3(0)
    factors.add(factor(swapped(np.full(6, 1e-5)), [0], lambda pose: first.between(pose)))
    for i, j, Z, Z_a in zip(edges.i, edges.j, edges.T_j_i, edges.T_j_i_assistant, strict=True):
        Z, Z_a = gtsam.Pose3(Z), gtsam.Pose3(Z_a)
        keys = [int(i), int(j)]
        factors.add(factor(swapped(sigma), keys, lambda i, j, Z=Z: Z.between(j.between(i))))
        factors.add(
            factor(
                swapped(sigma),
                [*keys, n],
                lambda i, j, rig, Z=Z_a: Z.between(j.compose(rig).between(i.compose(rig))),
            )
        )
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(1e-14)
    parameters.setAbsoluteErrorTol(1e-14)
    result = gtsam.LevenbergMarquardtOptimizer(factors, values, parameters).optimize()
    poses = np.stack([result.atPose3(key).matrix() for key in range(n)])
    return poses, result.atPose3(n).matrix(), factors.error(result)


def cost_of(graph):
    problem = graph.problem()
    return cost(problem, residuals(problem, graph.state()), cauchy)


@pytest.mark.parametrize("spacing", [1.0, 0.55])
def test_optimum_is_that_of_gtsams_own_exact_factors(spacing):
    graph = graph_of(curved(9, turn=0.15), noise=0.2, n_max=6, spacing=spacing)
    sigma = np.sqrt(np.repeat([0.1, 0.05], 3)) * np.repeat([spacing, 1.0], 3)
    sigma_prior = np.sqrt(0.01) * np.repeat([spacing, 1.0], 3)
    poses, T_p_a, least = reference_optimum(graph, sigma, sigma_prior)
    before = cost_of(graph)
    optimised(graph, tolerance=1e-15)
    assert before > 2 * cost_of(graph)
    assert cost_of(graph) == pytest.approx(least, rel=1e-8)
    assert np.abs(graph.poses() - poses).max() < 1e-6
    assert np.abs(graph.T_p_a - T_p_a).max() < 1e-6


def test_exact_measurements_are_left_alone():
    T = curved(40)
    graph = graph_of(T)
    optimised(graph)
    assert cost_of(graph) < 1e-20
    assert np.abs(graph.poses() - T).max() < 1e-9


def test_rig_is_recovered_from_motion_against_a_wrong_prior():
    T = curved(60, turn=0.2)
    wrong = T_P_A @ se3.exp(np.array([0.1, -0.05, 0.1, 0.05, -0.05, 0.03]))
    free = dataclasses.replace(CONFIG, rig_prior_variance=1e4)
    graph = graph_of(T, config=free)
    graph.set_rig_prior(wrong)
    optimised(graph)
    assert np.abs(graph.T_p_a - T_P_A).max() < 1e-3
    tight = graph_of(T, config=dataclasses.replace(CONFIG, rig_prior_variance=1e-8))
    tight.set_rig_prior(wrong)
    optimised(tight)
    assert np.abs(tight.T_p_a - wrong).max() < 0.01


def test_first_keyframe_stays_fixed():
    T = se3.exp(np.array([7.0, -2, 3, 0.4, 1.0, -0.3])) @ curved(20)
    graph = graph_of(T, noise=0.05)
    optimised(graph)
    assert np.abs(graph.poses()[0] - T[0]).max() < 1e-9


def test_a_true_loop_closes_a_long_drift_and_a_false_one_is_rejected():
    T = circle(120)
    graph = graph_of(T, noise=0.003, bias=SEVERE)
    open_error = position_error(graph.poses(), T)
    graph.add_loop(LoopClosure(119, 0, se3.inverse(T[0]) @ T[119]))
    graph.add_loop(LoopClosure(118, 1, se3.inverse(T[1]) @ T[118]))
    graph.add_loop(LoopClosure(116, 2, se3.inverse(T[2]) @ T[116]))
    optimised(graph)
    closed_error = position_error(graph.poses(), T)
    assert open_error[-1] > 5.0
    assert closed_error[-1] < 0.2
    assert closed_error.mean() < open_error.mean() / 2
    before = graph.poses()
    graph.add_loop(LoopClosure(60, 0, np.eye(4)))
    optimised(graph)
    across = [np.linalg.norm((X[60] - X[0])[:3, 3]) for X in (before, graph.poses())]
    assert across[1] > 0.9 * across[0] > 20.0


def test_a_bridge_yields_to_a_loop_before_odometry_does():
    T = circle(60)
    graph = JointGraph(CONFIG)
    graph.set_rig_prior(T_P_A)
    halves = np.arange(30), np.arange(30, 60)
    guess = T[29]  # as if nothing had moved in between
    for ids, T_w_s in zip(halves, (T[0], guess), strict=True):
        T_s = se3.inverse(T[ids[0]])
        T_s_p, T_s_a = T_s @ T[ids], T_s @ T[ids] @ T_P_A
        graph.add_submap(tuple(ids.tolist()), T_w_s, T_s_p, T_s_a, np.arange(30))
    graph.add_bridge(29, 30)
    for query, match in ((59, 0), (45, 10), (35, 20)):
        graph.add_loop(LoopClosure(query, match, se3.inverse(T[match]) @ T[query]))
    optimised(graph)
    poses = graph.poses()
    gap, true_gap = (np.linalg.norm((X[30] - X[29])[:3, 3]) for X in (poses, T))
    assert gap > 0.75 * true_gap
    assert position_error(poses[halves[1]], T[halves[1]]).max() < 0.2 * true_gap


def test_views_without_an_assistant_still_hold_by_the_primary():
    T = curved(10)
    graph = JointGraph(CONFIG)
    graph.set_rig_prior(T_P_A)
    seen = np.array([0, 1, 2, 7])
    graph.add_submap(tuple(range(10)), np.eye(4), T, (T @ T_P_A)[seen], seen)
    edges = graph.problem().edges
    pairs = {(int(i), int(j)) for i, j in zip(edges.i, edges.j, strict=True)}
    assert pairs == {(i, j) for i in range(10) for j in range(max(0, i - 3), i)}
    weighed = {
        (int(i), int(j))
        for i, j, w in zip(edges.i, edges.j, edges.weight_assistant, strict=True)
        if w > 0
    }
    assert weighed == {(1, 0), (2, 0), (2, 1)}
    optimised(graph)
    assert np.abs(graph.poses() - T).max() < 1e-9


def test_two_runs_agree_to_the_bit():
    runs = []
    for _ in range(2):
        graph = graph_of(curved(80), noise=0.05)
        graph.add_loop(LoopClosure(79, 0, curved(80)[79]))
        optimised(graph)
        runs.append(graph.poses().tobytes() + graph.T_p_a.tobytes())
    assert runs[0] == runs[1]


def test_an_optimum_of_an_earlier_snapshot_takes_later_keyframes_along():
    T = curved(60)
    graph, grown = graph_of(T[:39], noise=0.05), graph_of(T, noise=0.05)
    solved = Solved(grown.snapshot().graph, optimum(graph.problem(), graph.state()))
    late = se3.inverse(grown.poses()[38]) @ grown.poses()[38:]
    assert grown.apply(solved)
    assert np.array_equal(grown.poses()[:39], solved.optimum.state.T_w_p)
    assert np.abs(se3.inverse(grown.poses()[38]) @ grown.poses()[38:] - late).max() < 1e-12
    assert np.array_equal(grown.T_p_a, solved.optimum.state.T_p_a)


def test_an_optimum_of_another_graph_is_not_taken():
    graph = graph_of(curved(30), noise=0.05)
    before = graph.poses()
    other = graph_of(curved(30), noise=0.05)
    assert not graph.apply(Solved(other.snapshot().graph, optimum(other.problem(), other.state())))
    assert np.array_equal(graph.poses(), before)


def test_optimising_needs_a_rig_prior():
    graph = JointGraph(CONFIG)
    with pytest.raises(ValueError, match="set_rig_prior"):
        graph.problem()
    assert graph.snapshot() is None


def test_gtsam_waits_until_it_is_needed():
    code = "import calm_edge.estimator.localizer, sys; sys.exit('gtsam' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


def test_a_longer_bridge_is_looser():
    T = curved(4)
    weights = []
    for sigma in ((0.0, 0.0), (5.0, 0.5), (50.0, 1.5)):
        graph = JointGraph(CONFIG)
        graph.set_rig_prior(T_P_A)
        graph.add_submap(tuple(range(4)), np.eye(4), T, T @ T_P_A, np.arange(4))
        graph.add_bridge(0, 3, *sigma)
        weights.append(float(graph.problem().edges.weight[-1]))
    assert weights[0] > weights[1] > 50 * weights[2]
    # one edge's sigma is that of the paper, in spacings
    assert weights[1] == pytest.approx(CONFIG.translation_variance / 25)


def test_no_edge_crosses_a_cut():
    T = curved(10)
    graph = JointGraph(CONFIG)
    graph.set_rig_prior(T_P_A)
    graph.add_submap(tuple(range(10)), np.eye(4), T, T @ T_P_A, np.arange(10), None, (4, 7))
    edges = graph.problem().edges
    part = np.searchsorted([4, 7], np.arange(10), side="right")
    assert len(edges.i) > 9 and (part[edges.i] == part[edges.j]).all()
    assert len(graph) == 10
