import dataclasses

import numpy as np
import pytest

from calm_edge.geometry import se3
from calm_edge.posegraph.joint_graph import JointGraph
from calm_edge.posegraph.noise import assumed_noise, measured_noise, measured_twice
from tests.drives import T_P_A, curved
from tests.posegraph.graphs import CONFIG, graph_of


@pytest.mark.parametrize("noise", [0.005, 0.05])
def test_simulated_noise_is_recovered(noise):
    found = measured_noise(graph_of(curved(600), noise=noise).problem())
    assert found.translation == pytest.approx(noise, rel=0.1)
    assert found.rotation == pytest.approx(noise / 10, rel=0.1)


def test_pairs_measured_twice_are_found_in_any_order():
    edges = graph_of(curved(27), noise=0.01).problem().edges
    first, second = measured_twice(edges)
    pairs = {(int(edges.i[a]), int(edges.j[a])) for a in first}
    assert pairs == {(13, 12), (14, 12), (14, 13)}
    assert (edges.i[first] == edges.i[second]).all()
    assert (edges.submap[first] != edges.submap[second]).all()
    assert len(measured_twice(edges.chosen(np.arange(len(edges.i))[::-1]))[0]) == 3


def test_bridges_do_not_count_as_measured_twice():
    graph = graph_of(curved(15), noise=0.01)
    graph.add_bridge(3, 4)
    graph.add_bridge(3, 4)
    assert measured_noise(graph.problem()) is None


def test_scale_noise_is_recovered_from_the_overlap_of_submaps():
    rng, T, graph = np.random.default_rng(2), curved(600), JointGraph(CONFIG)
    graph.set_rig_prior(T_P_A)
    for start in range(0, len(T) - 3, 12):
        ids = tuple(range(start, min(start + 15, len(T))))
        T_s = se3.inverse(T[start])
        T_s_p, T_s_a = T_s @ T[list(ids)], T_s @ T[list(ids)] @ T_P_A
        for poses in (T_s_p, T_s_a):
            poses[:] = poses @ se3.exp(rng.normal(size=(len(ids), 6)) * 1e-3)
        factor = np.exp(0.05 * rng.normal())
        T_s_p[:, :3, 3] *= factor
        T_s_a[:, :3, 3] *= factor
        graph.add_submap(ids, np.eye(4), T_s_p, T_s_a, np.arange(len(ids)))
    assert measured_noise(graph.problem()).scale == pytest.approx(0.05, rel=0.3)


def test_scale_noise_is_at_least_that_of_the_spacing_scatter():
    problem = graph_of(curved(600), noise=0.01).problem()
    spacing = np.linalg.norm(T_P_A[:3, 3])
    assert problem.scale_sigma == pytest.approx(0.01 * np.sqrt(2 / 15) / spacing, rel=0.1)
    louder = dataclasses.replace(problem, scale_sigma=0.2)
    assert measured_noise(louder).scale == pytest.approx(0.2)


def test_assumed_noise_is_half_the_configured_variance():
    noise = assumed_noise(graph_of(curved(15), spacing=2.0).problem())
    assert 2 * noise.translation**2 == pytest.approx(0.1 * 2.0**2)
    assert 2 * noise.rotation**2 == pytest.approx(0.05)


@pytest.mark.parametrize("share", [0.2, 0.8])
def test_submaps_drawn_to_the_one_before_do_not_lower_the_noise(share):
    rng, T, graph = np.random.default_rng(3), curved(1200), JointGraph(CONFIG)
    graph.set_rig_prior(T_P_A)
    noise, before = 0.01, None
    for start in range(0, len(T) - 3, 12):
        ids = tuple(range(start, min(start + 15, len(T))))
        T_s = se3.inverse(T[start])
        views = []
        for k, T_s_c in enumerate((T_s @ T[list(ids)], T_s @ T[list(ids)] @ T_P_A)):
            twist = noise * rng.normal(size=(len(ids), 6))
            if before is not None:
                twist[:3] = share * twist[:3] + (1 - share) * before[k]
            views.append((T_s_c @ se3.exp(twist), twist[-3:]))
        (T_s_p, own), (T_s_a, other) = views
        drawn = None if before is None else np.full(2, share)
        before = own, other
        graph.add_submap(ids, np.eye(4), T_s_p, T_s_a, np.arange(len(ids)), drawn)
    found = measured_noise(graph.problem())
    assert found.translation == pytest.approx(noise, rel=0.15)
    assert found.rotation == pytest.approx(noise, rel=0.15)
