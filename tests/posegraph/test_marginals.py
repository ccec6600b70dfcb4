import numpy as np

from bench.consistency import consistent_band, pose_nees
from calm_edge.geometry import se3
from calm_edge.posegraph.joint_graph import JointGraph
from calm_edge.posegraph.marginals import Marginals
from calm_edge.posegraph.noise import Noise, measured_noise
from calm_edge.types import LoopClosure
from tests.drives import T_P_A, curved
from tests.posegraph.graphs import CONFIG, graph_of, optimised

# keyframes of the drive, of a sub-map, and from one sub-map to the next
N, SIZE, STEP = 15, 9, 6


def submaps(T, moved=None):
    """Graph of exact sub-maps with one error, `moved`.

    (sub-map, eye, view, twist) moves a view; (sub-map, log scale) scales a sub-map.
    """
    graph = JointGraph(CONFIG)
    graph.set_rig_prior(T_P_A)
    for k, start in enumerate(range(0, len(T) - 3, STEP)):
        ids = tuple(range(start, min(start + SIZE, len(T))))
        eyes = [T[list(ids)], T[list(ids)] @ T_P_A]
        T_s = se3.inverse(T[start])
        eyes = [T_s @ views for views in eyes]
        if moved is not None and moved[0] == k:
            if len(moved) == 4:
                _, eye, view, twist = moved
                eyes[eye][view] = eyes[eye][view] @ se3.exp(twist)
            else:
                for views in eyes:
                    views[:, :3, 3] *= np.exp(moved[1])
        graph.add_submap(ids, T[start], *eyes, np.arange(len(ids)))
    graph.add_loop(LoopClosure(N - 1, 0, se3.inverse(T[0]) @ T[N - 1]))
    return graph


def shifts(T, moved, row, origins):
    """Twists (M, 6) by which `moved` shifts the optimised pose of `row` relative to origins."""
    graph = submaps(T, moved)
    optimised(graph, tolerance=1e-9)
    X = graph.poses()
    truth = se3.inverse(T[origins]) @ T[row]
    return se3.log(se3.inverse(truth) @ se3.inverse(X[origins]) @ X[row])


def test_the_covariance_is_the_sum_over_all_single_errors():
    T, row, origins, h = curved(N, turn=0.1), 11, [0, 5], 1e-4
    noise = Noise(translation=0.01, rotation=0.002, scale=0.03)
    sigma = np.repeat([noise.translation, noise.rotation], 3)
    answers = []
    for k in (0, 1):
        for eye, view in np.ndindex(2, SIZE):
            for axis in np.eye(6):
                answers.append(shifts(T, (k, eye, view, axis * h), row, origins) * (axis @ sigma))
        answers.append(shifts(T, (k, h), row, origins) * noise.scale)
    expected = np.einsum("eoi,eoj->oij", answers, answers) / h**2
    graph = submaps(T)
    for origin, wanted in zip(origins, expected, strict=True):
        found, rest = (
            Marginals(graph.problem(), graph.state(), n).covariances(np.array([row]), origin)[0]
            # with zero noise only the loop's share remains, which `shifts` does not contain
            for n in (noise, Noise(0.0, 0.0, 0.0))
        )
        assert np.linalg.norm(found - rest - wanted) < 0.02 * np.linalg.norm(wanted)


def test_normalised_errors_of_independent_drives_match_the_covariance():
    T, rows, values = curved(51), np.array([12, 50]), []
    for seed in range(20):
        graph = graph_of(T, noise=0.02, seed=seed)
        optimised(graph)
        X = se3.inverse(graph.poses()[0]) @ graph.poses()
        truth = se3.inverse(T[0]) @ T
        problem = graph.problem()
        # the scale of these sub-maps has no noise
        noise = Noise(0.02, 0.002, 0.0)
        covariance = Marginals(problem, graph.state(), noise).covariances(rows)
        values.append(pose_nees(X[rows], truth[rows], covariance) / 6)
    low, high = consistent_band(20, confidence=0.99)
    assert (np.mean(values, 0) > low).all()
    assert (np.mean(values, 0) < high).all()


def test_covariances_grow_from_the_first_keyframe():
    graph = graph_of(curved(80), noise=0.02)
    optimised(graph)
    problem = graph.problem()
    marginals = Marginals(problem, graph.state(), measured_noise(problem))
    covariance = marginals.covariances(np.array([0, 20, 79]))
    sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    assert np.abs(sigma[0]).max() < 1e-9
    assert (sigma[2] > sigma[1]).all()
